//! Where the eBPF object is.

use std::path::{Path, PathBuf};

/// Names the object file; for development and tests.
pub const ENVIRONMENT: &str = "GDP_EBPF_OBJECT";

const FILE: &str = "gdp-ebpf";

/// The file to load: what was asked for, else what the environment names, else beside this executable, else where the
/// package puts it. The error holds the places that were looked at.
pub fn find(wanted: Option<&Path>) -> Result<PathBuf, Vec<PathBuf>> {
    let named = wanted.map(PathBuf::from).or_else(|| std::env::var_os(ENVIRONMENT).map(PathBuf::from));
    // A file that was named and is not there is a mistake, not a reason to load another.
    let places = match named {
        Some(file) => vec![file],
        None => {
            let beside = std::env::current_exe().ok().and_then(|exe| Some(exe.parent()?.join(FILE)));
            beside.into_iter().chain([Path::new("/usr/lib/gdp").join(FILE)]).collect()
        }
    };
    places.iter().find(|file| file.is_file()).cloned().ok_or(places)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_was_named_is_the_only_candidate() {
        let missing = Path::new("/nonexistent/gdp-ebpf");
        assert_eq!(find(Some(missing)), Err(vec![missing.to_owned()]));
        let exe = std::env::current_exe().expect("this test");
        assert_eq!(find(Some(&exe)), Ok(exe));
    }
}
