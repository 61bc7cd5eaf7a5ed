//! Unit tests of `pins`.

use super::*;

#[test]
fn files_are_told_apart_by_name() {
    let of = |name: &str| link_of(Path::new(name));
    assert_eq!(of("/x/xdp-7-native"), Some((7, Mode::Native)));
    assert_eq!(of("/x/xdp-12-generic"), Some((12, Mode::Generic)));
    for other in ["LINKS", "xdp-7", "xdp-7-fast", "xdp--native"] {
        assert_eq!(of(other), None, "{other}");
    }
}

#[test]
fn a_switch_has_one_owner_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("gdp/v1/75e1000000000000-4026531840");
    fs::create_dir_all(&place).unwrap();
    assert_eq!(find(folder.path()).unwrap(), [], "an empty folder is nothing");
    fs::write(place.join("xdp-3-native"), []).unwrap();
    fs::write(place.join("FIB"), []).unwrap();
    let found = find(folder.path()).unwrap();
    assert_eq!((found[0].switch.as_str(), found[0].abi, found[0].namespace), ("75e1000000000000", 1, 4026531840));
    assert_eq!(found[0].links(), [(3, Mode::Native)]);
    let pins = Pins::of(&found[0]).unwrap();
    assert!(matches!(Pins::of(&found[0]), Err(PinsError::InUse(_))));
    let of_a_child = pins.lock.try_clone().unwrap();
    drop(pins);
    let pins = Pins::of(&found[0]).expect("a process that is being started does not own the switch");
    drop(of_a_child);
    pins.remove().unwrap();
    assert!(!place.exists());
}

#[test]
fn a_folder_with_something_in_it_is_not_mounted_over() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("file"), []).unwrap();
    let place = PinLocation { bpffs: folder.path().into(), switch: Name::default(), replaces: false };
    let error = Pins::open(&place).unwrap_err();
    assert!(error.is_bearable() && error.to_string().contains("something else"), "{error}");
}

#[test]
fn pins_of_another_abi_are_removed_with_keep_and_an_error_without() {
    let folder = tempfile::tempdir().unwrap();
    let place = |abi: u32| folder.path().join(format!("gdp/v{abi}/75e1000000000000-4026531840"));
    for abi in [ABI, ABI + 1] {
        fs::create_dir_all(place(abi)).unwrap();
        fs::write(place(abi).join("FIB"), []).unwrap();
    }
    let ours = find(folder.path()).unwrap();
    let refused = remove_other_versions(&ours, false).unwrap_err();
    assert!(matches!(&refused, PinsError::OtherAbi(left) if *left == place(ABI + 1)), "{refused}");
    assert!(!refused.is_bearable() && place(ABI + 1).exists());

    let other = ours.iter().find(|found| found.abi != ABI).unwrap();
    let its_daemon = Pins::of(other).unwrap();
    assert!(matches!(remove_other_versions(&ours, true), Err(PinsError::InUse(_))), "its daemon runs");
    drop(its_daemon);
    remove_other_versions(&ours, true).unwrap();
    assert!(!place(ABI + 1).exists() && place(ABI).join("FIB").exists());
    assert_eq!(find(folder.path()).unwrap().len(), 1);
}
