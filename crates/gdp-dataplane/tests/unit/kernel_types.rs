//! Unit tests of `kernel_types`.

use super::*;

/// `struct outer { u32 first; union { struct { u32 deep; named last; }; }; }`, `typedef struct {
/// u32 inner; } named`.
fn sample() -> Vec<u8> {
    let strings = b"\0outer\0first\0deep\0last\0inner\0";
    let name = |text: &[u8]| strings.windows(text.len()).position(|w| w == text).unwrap() as u32;
    let info = |kind: u32, members: u32| kind << 24 | members;
    let types: Vec<u32> = [
        vec![0, info(1, 0), 4, 32],
        vec![name(b"outer"), info(KIND_STRUCT, 2), 16, name(b"first"), 1, 0, 0, 3, 32],
        vec![0, info(KIND_UNION, 1), 8, 0, 4, 0],
        vec![0, info(KIND_STRUCT, 2), 8, name(b"deep"), 1, 0, name(b"last"), 5, 32],
        vec![0, info(KIND_TYPEDEF, 0), 6],
        vec![0, info(KIND_STRUCT, 1) | 1 << 31, 4, name(b"inner"), 1, 7 << 24 | 8],
    ]
    .concat();
    let length = types.len() as u32 * 4;
    let header = [24, 0, length, length, strings.len() as u32];
    let mut data = vec![0x9f, 0xeb, 1, 0];
    data.extend(header.iter().chain(&types).flat_map(|word| word.to_ne_bytes()));
    data.extend(strings);
    data
}

#[test]
fn fields_are_found_through_anonymous_structures_and_typedefs() {
    let types = KernelTypes::parse("sample".into(), sample()).expect("well formed");
    assert_eq!(types.offset("outer", &["first"]).unwrap(), 0);
    assert_eq!(types.offset("outer", &["deep"]).unwrap(), 4);
    assert_eq!(types.offset("outer", &["last", "inner"]).unwrap(), 9);
    let missing = types.offset("outer", &["first", "x"]).unwrap_err().to_string();
    assert_eq!(missing, "the kernel has no `struct outer.first.x`");
    assert!(types.offset("other", &["first"]).is_err());
}

#[test]
fn nonsense_is_refused_or_finds_nothing() {
    let whole = sample();
    for length in 0..whole.len() {
        if let Some(types) = KernelTypes::parse("cut".into(), whole[..length].to_vec()) {
            let _ = types.offset("outer", &["last", "inner"]);
        }
    }
    for at in 0..whole.len() {
        let mut mutated = whole.clone();
        mutated[at] ^= 0xff;
        if let Some(types) = KernelTypes::parse("mutated".into(), mutated) {
            let _ = types.offset("outer", &["last", "inner"]);
        }
    }
    let mut huge = whole;
    huge[4..8].copy_from_slice(&u32::MAX.to_ne_bytes());
    assert!(KernelTypes::parse("huge".into(), huge).is_none());
}

#[test]
fn this_kernel_has_what_is_asked_for() {
    if !Path::new(VMLINUX).exists() {
        return;
    }
    let types = KernelTypes::load(Path::new(VMLINUX)).unwrap();
    for (structure, path) in
        [("net_device", &["ifindex"][..]), ("net_device", &["nd_net", "net"]), ("net", &["ns", "inum"])]
    {
        assert!(types.offset(structure, path).unwrap() < 1 << 16, "{structure} {path:?}");
    }
}
