//! Unit tests of `embedded`.

use super::*;
use crate::Schema;

#[test]
fn every_embedded_type_resolves_and_survives_its_bundle() {
    let registry = Registry::embedded();
    for dialect in [Dialect::Ros1, Dialect::Ros2] {
        let names: Vec<_> = registry.names(dialect).collect();
        assert!(names.len() > 150, "{}", names.len());
        for name in names {
            let schema = Schema::resolve(&registry, dialect, name).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(Schema::from_bundle(&schema.bundle()).unwrap(), schema);
        }
    }
}
