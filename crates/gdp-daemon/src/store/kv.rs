//! The keys, values and transactions of etcd.

/// A key with its value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyValue {
    pub key: Vec<u8>,
    pub value: Vec<u8>,
    pub create_revision: i64,
    pub mod_revision: i64,
    pub lease: i64,
}

/// A condition of a transaction: a key's revision. Revision 0 means that the key does not exist.
#[derive(Clone, Debug)]
pub enum Compare<'a> {
    Created(&'a [u8], i64),
    Modified(&'a [u8], i64),
}

/// An operation of a transaction.
#[derive(Clone, Debug)]
pub enum Op<'a> {
    Put { key: &'a [u8], value: &'a [u8], lease: i64 },
    Delete(&'a [u8]),
    Get(&'a [u8]),
}

/// The outcome of a transaction.
#[derive(Debug)]
pub struct Outcome {
    pub succeeded: bool,
    pub revision: i64,
    /// The result of each [`Op::Get`], in order.
    pub found: Vec<Option<KeyValue>>,
}

/// A change of a key.
#[derive(Debug, PartialEq, Eq)]
pub enum WatchEvent {
    Put(KeyValue),
    /// The value is empty, and the revision is that of the deletion.
    Delete(KeyValue),
}
