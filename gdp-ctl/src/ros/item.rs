//! The values of a message as YAML.

/// A value to print.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    Bool(bool),
    Integer(i128),
    Float(f64),
    Text(String),
    List(Vec<Item>),
    /// Fields by name, in this order.
    Map(Vec<(String, Item)>),
}
