//! The values of a message as YAML.

/// What is printed.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    Bool(bool),
    Integer(i128),
    Float(f64),
    Text(String),
    List(Vec<Item>),
    /// By name, in this order.
    Map(Vec<(String, Item)>),
}
