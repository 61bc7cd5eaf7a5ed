//! Checks state machines of the control plane in every order of events, in networks of a few
//! nodes. `GDP_MODEL_FAULTS` sets the number of faults in each run.

mod leadership;
mod topology;

use std::fmt::{Debug, Write};
use std::hash::{DefaultHasher, Hash, Hasher};

/// Returns the number of faults in each run: that of the environment, or `default`.
fn faults(default: u32) -> u32 {
    std::env::var("GDP_MODEL_FAULTS").map_or(default, |text| text.parse().expect("GDP_MODEL_FAULTS is a number"))
}

/// A state that is identified by its debug output. The state machines of the product need no
/// equality.
#[derive(Clone, Debug)]
struct DebugHash<T> {
    state: T,
    hash: u64,
}

impl<T: Debug> DebugHash<T> {
    fn new(state: T) -> Self {
        let mut hasher = Hashed(DefaultHasher::new());
        write!(hasher, "{state:?}").expect("hashing does not fail");
        Self { state, hash: hasher.0.finish() }
    }

    fn get(&self) -> &T {
        &self.state
    }
}

impl<T> PartialEq for DebugHash<T> {
    fn eq(&self, other: &Self) -> bool {
        self.hash == other.hash
    }
}

impl<T> Eq for DebugHash<T> {}

impl<T> Hash for DebugHash<T> {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.hash.hash(state);
    }
}

struct Hashed(DefaultHasher);

impl Write for Hashed {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        text.hash(&mut self.0);
        Ok(())
    }
}
