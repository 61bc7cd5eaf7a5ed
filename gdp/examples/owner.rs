//! Creates a topic's name, and lets one entity publish it and another read it, for a week.
//!
//! `owner FOLDER PUBLISHER READER`: the names are those that `gdp-ctl key show` prints.

use std::path::PathBuf;

use gdp::{NameCard, SigningKey};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder, publisher, reader] = &arguments[..] else { return Err("owner FOLDER PUBLISHER READER".into()) };
    let (folder, owner) = (PathBuf::from(folder), SigningKey::generate()?);
    owner.save_new(&folder.join("owner.pem"))?;
    let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "std_msgs/msg/String", None)?;
    card.save_new(&folder.join("chatter.card"))?;
    let publish = owner.allow_publish(&card, publisher.parse()?).for_days(7).sign()?;
    std::fs::write(folder.join("chatter.ad"), publish.to_pem())?;
    let read = owner.allow_read(&card, reader.parse()?).for_days(7).sign()?;
    Ok(std::fs::write(folder.join("chatter.grant"), read.to_pem())?)
}
