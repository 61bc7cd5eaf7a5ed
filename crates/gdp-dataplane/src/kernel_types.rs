//! Offsets of fields in the running kernel's structures, read from its BTF
//! (Documentation/bpf/btf.rst). This module covers only the needs of [`super::losses`]: structures,
//! their members, and the types between them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The running kernel's BTF.
pub const VMLINUX: &str = "/sys/kernel/btf/vmlinux";

/// Size limit. The BTF of a real kernel has about 6 MB.
const LARGEST: u64 = 256 << 20;

const MAGIC: u16 = 0xeb9f;
const KIND_ARRAY: u32 = 3;
const KIND_STRUCT: u32 = 4;
const KIND_UNION: u32 = 5;
const KIND_TYPEDEF: u32 = 8;
/// Maximum depth of nested anonymous structures, and of chains of typedefs and qualifiers.
const DEEPEST: u32 = 16;

#[derive(Debug, thiserror::Error)]
pub enum TypesError {
    #[error("the kernel does not describe its types: {}: {source} (CONFIG_DEBUG_INFO_BTF)", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{} is not a description of types", .0.display())]
    Malformed(PathBuf),
    #[error("the kernel has no `{0}`")]
    NoField(String),
}

/// The types by number, and the structures by name.
pub struct KernelTypes {
    path: PathBuf,
    data: Vec<u8>,
    /// Offset of each type in `data`; number 0 is `void`.
    types: Vec<usize>,
    strings: usize,
    structures: HashMap<Vec<u8>, u32>,
}

impl KernelTypes {
    pub fn load(path: &Path) -> Result<Self, TypesError> {
        use std::io::Read;
        let mut data = Vec::new();
        std::fs::File::open(path)
            .and_then(|file| file.take(LARGEST).read_to_end(&mut data))
            .map_err(|source| TypesError::Read { path: path.into(), source })?;
        Self::parse(path.into(), data).ok_or_else(|| TypesError::Malformed(path.into()))
    }

    fn parse(path: PathBuf, data: Vec<u8>) -> Option<Self> {
        let mut btf = Self { path, data, types: vec![0], strings: 0, structures: HashMap::new() };
        if btf.data.first_chunk().map(|magic| u16::from_ne_bytes(*magic)) != Some(MAGIC) {
            return None;
        }
        let header = btf.word(4)? as usize;
        let begin = header.checked_add(btf.word(8)? as usize)?;
        let end = begin.checked_add(btf.word(12)? as usize)?;
        btf.strings = header.checked_add(btf.word(16)? as usize)?;
        let mut at = begin;
        while at < end {
            let number = u32::try_from(btf.types.len()).ok()?;
            let (kind, count) = btf.kind(at)?;
            btf.types.push(at);
            if kind == KIND_STRUCT {
                let name = btf.string(btf.word(at)?)?.to_vec();
                btf.structures.entry(name).or_insert(number);
            }
            at = at.checked_add(12 + size_behind(kind, count)?)?;
        }
        Some(btf)
    }

    /// Returns the offset in bytes of the last field of `path` from the start of `structure`. Each
    /// field of `path` lies in the structure of the preceding field.
    pub fn offset(&self, structure: &str, path: &[&str]) -> Result<u32, TypesError> {
        let missing = || TypesError::NoField(format!("struct {structure}.{}", path.join(".")));
        let mut number = *self.structures.get(structure.as_bytes()).ok_or_else(missing)?;
        let mut bits = 0;
        for name in path {
            let at = self.resolve(number).ok_or_else(missing)?;
            let (member, offset) = self.member(at, name.as_bytes(), DEEPEST).ok_or_else(missing)?;
            (number, bits) = (member, offset.checked_add(bits).ok_or_else(missing)?);
        }
        if bits % 8 == 0 { Ok(bits / 8) } else { Err(TypesError::Malformed(self.path.clone())) }
    }

    /// Returns the type of a member and its offset in bits.
    fn member(&self, structure: usize, name: &[u8], depth: u32) -> Option<(u32, u32)> {
        let (kind, count) = self.kind(structure)?;
        if !matches!(kind, KIND_STRUCT | KIND_UNION) || depth == 0 {
            return None;
        }
        // If the structure has bit fields, the highest byte of an offset is the size of the bit
        // field.
        let mask = if self.word(structure + 4)? >> 31 == 1 { 0x00ff_ffff } else { u32::MAX };
        for at in (0..count).map(|i| structure + 12 + 12 * i) {
            let (number, offset) = (self.word(at + 4)?, self.word(at + 8)? & mask);
            match self.string(self.word(at)?)? {
                found if found == name => return Some((number, offset)),
                b"" => {
                    let inner = self.resolve(number).and_then(|inner| self.member(inner, name, depth - 1));
                    if let Some((number, further)) = inner {
                        return Some((number, offset.checked_add(further)?));
                    }
                }
                _ => {}
            }
        }
        None
    }

    /// Returns the offset of the underlying type, following typedefs and qualifiers.
    fn resolve(&self, mut number: u32) -> Option<usize> {
        for _ in 0..DEEPEST {
            let at = *self.types.get(number as usize).filter(|at| **at != 0)?;
            match self.kind(at)?.0 {
                // `typedef`, `volatile`, `const`, `restrict`, and type tags.
                KIND_TYPEDEF..=11 | 18 => number = self.word(at + 8)?,
                _ => return Some(at),
            }
        }
        None
    }

    /// Returns the kind of a type and its number of members.
    fn kind(&self, at: usize) -> Option<(u32, usize)> {
        let info = self.word(at + 4)?;
        Some((info >> 24 & 0x1f, (info & 0xffff) as usize))
    }

    fn word(&self, at: usize) -> Option<u32> {
        Some(u32::from_ne_bytes(*self.data.get(at..)?.first_chunk()?))
    }

    fn string(&self, at: u32) -> Option<&[u8]> {
        let text = self.data.get(self.strings.checked_add(at as usize)?..)?;
        Some(&text[..text.iter().position(|byte| *byte == 0)?])
    }
}

/// Returns the size in bytes of the data after the first 12 bytes of a type.
fn size_behind(kind: u32, members: usize) -> Option<usize> {
    Some(match kind {
        // Integer, variable, declaration tag.
        1 | 14 | 17 => 4,
        KIND_ARRAY => 12,
        KIND_STRUCT | KIND_UNION | 15 | 19 => 12 * members,
        // Enumeration, function prototype.
        6 | 13 => 8 * members,
        // Pointer, forward, the kinds that `resolve` follows, function, float.
        2 | 7..=12 | 16 | 18 => 0,
        _ => return None,
    })
}

#[cfg(test)]
#[path = "../tests/unit/kernel_types.rs"]
mod tests;
