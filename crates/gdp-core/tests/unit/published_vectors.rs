//! The published test vectors, `docs/vectors`: recomputed by the tests beside what they are about,
//! and compared here. `GDP_WRITE_VECTORS=1 cargo test -p gdp vectors` writes them anew.

use std::fs;
use std::path::PathBuf;

use serde_json::Value;

pub fn check(file: &str, computed: &Value) {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/vectors").join(file);
    if std::env::var_os("GDP_WRITE_VECTORS").is_some() {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, serde_json::to_string_pretty(computed).unwrap() + "\n").unwrap();
    }
    let text = fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let published: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(&published, computed, "{file} differs from what this code computes");
}
