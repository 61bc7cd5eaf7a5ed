//! Keys, values and transactions, as etcd has them.

/// A key and its value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyValue {
    pub key: Vec<u8>,
    pub value: Vec<u8>,
    pub create_revision: i64,
    pub mod_revision: i64,
    pub lease: i64,
}

/// A condition of a transaction, on the revision of a key (0: it is not there).
#[derive(Clone, Debug)]
pub enum Compare<'a> {
    Created(&'a [u8], i64),
    Modified(&'a [u8], i64),
}

/// What a transaction does.
#[derive(Clone, Debug)]
pub enum Op<'a> {
    Put { key: &'a [u8], value: &'a [u8], lease: i64 },
    Delete(&'a [u8]),
    Get(&'a [u8]),
}

/// What came of a transaction.
#[derive(Debug)]
pub struct Outcome {
    pub succeeded: bool,
    pub revision: i64,
    /// What was found for each [`Op::Get`], in their order.
    pub found: Vec<Option<KeyValue>>,
}

/// What has changed at a key.
#[derive(Debug, PartialEq, Eq)]
pub enum Event {
    Put(KeyValue),
    /// The value is empty, the revision that of the deletion.
    Delete(KeyValue),
}
