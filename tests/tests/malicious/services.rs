//! A client gone bad, beside another client of the same service: requests are sealed under a key of the client that the server
//! alone is given, replies under a key of the server that the one client alone is given.

use anyhow::{Context, Result};
use gdp::cert::issue;
use gdp::control::{EntityRequest, NameRole, RefusalCode, Response};
use gdp::crypto::Backend;
use gdp::keys::{self, KeyBox};
use gdp::seal::{EpochKey, Writer};
use gdp::{Identity, Name};

use crate::evil::{Frame, Owner, Rogue, Switch, bodies};

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn another_client_reads_neither_requests_nor_replies() -> Result<()> {
    let (switch, owner) = (Switch::start()?, Owner::new("/plan")?);
    let (mut server, mut client, mut other) =
        (Rogue::attach(&switch)?, Rogue::attach(&switch)?, Rogue::attach(&switch)?);
    let name = owner.name();
    for (entity, role) in
        [(&mut server, NameRole::Server), (&mut client, NameRole::Caller), (&mut other, NameRole::Caller)]
    {
        let stated = entity.state(&switch, &owner, role)?;
        assert!(matches!(stated, Response::Peers(_)), "{stated:?}");
    }
    let (requests, replies) = (EpochKey::generate()?, EpochKey::generate()?);
    let to_server = wrapped(&client, name, &server, &requests)?;
    let to_client = wrapped(&server, client.name(), &client, &replies)?;
    for (entity, boxed) in [(&client, &to_server), (&server, &to_client)] {
        let done = store(&switch, &entity.identity, boxed);
        assert!(matches!(done, Response::Done), "{done:?}");
    }
    // The frames are everybody's: the switch copies them to whom it likes.
    let request = sealed(&client, name, &requests, b"where to?", other.name())?;
    let reply = sealed(&server, client.name(), &replies, b"home", other.name())?;
    let frames = [request, reply].concat();
    switch.inject(&frames);
    for entity in [&mut server, &mut client, &mut other] {
        entity.listen(&switch);
    }
    assert_eq!(bodies(&server.read(name, &client.identity, &frames)?), [b"where to?"]);
    assert_eq!(bodies(&client.read(client.name(), &server.identity, &frames)?), [b"home"]);

    assert!(other.read(name, &client.identity, &frames)?.is_empty());
    assert!(other.read(client.name(), &server.identity, &frames)?.is_empty());
    assert!(other.boxes().is_empty(), "the RIB gives a box to its reader only");
    // A RIB that gives it to others gives them nothing.
    for (boxed, name, writer, reader) in
        [(&to_server, name, &client.identity, &server), (&to_client, client.name(), &server.identity, &client)]
    {
        let key = writer.key().verify_key();
        let as_itself = (other.name(), other.identity.box_key());
        assert!(keys::open(boxed, name, (writer.name(), &key), as_itself).is_err());
        let as_reader = (reader.name(), other.identity.box_key());
        assert!(keys::open(boxed, name, (writer.name(), &key), as_reader).is_err());
    }
    Ok(())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_answers_no_other_client() -> Result<()> {
    let (switch, owner) = (Switch::start()?, Owner::new("/plan")?);
    let (mut server, mut client, mut other) =
        (Rogue::attach(&switch)?, Rogue::attach(&switch)?, Rogue::attach(&switch)?);
    for (entity, role) in
        [(&mut server, NameRole::Server), (&mut client, NameRole::Caller), (&mut other, NameRole::Caller)]
    {
        entity.state(&switch, &owner, role)?;
    }
    let key = EpochKey::generate()?;
    // It is no counterpart of the client, so the RIB takes no box of it for the client's inbox; nor one in the server's name.
    let own = wrapped(&other, client.name(), &client, &key)?;
    let claims = KeyBox { writer: server.name(), ..own.claims_unverified()? };
    let in_the_servers_name = issue(other.identity.key(), &claims)?;
    for (boxed, code) in [(&own, RefusalCode::NotEntitled), (&in_the_servers_name, RefusalCode::WrongEntity)] {
        match store(&switch, &other.identity, boxed) {
            Response::Refused(refused) => assert_eq!(refused.code, code, "{refused}"),
            taken => panic!("taken: {taken:?}"),
        }
    }
    // And if a RIB gave it to the client, it would not open there as the server's.
    let opened = keys::open(
        &in_the_servers_name,
        client.name(),
        (server.name(), &server.identity.key().verify_key()),
        (client.name(), client.identity.box_key()),
    );
    assert!(opened.is_err());
    client.listen(&switch);
    assert!(client.boxes().is_empty());
    Ok(())
}

fn wrapped(writer: &Rogue, name: Name, reader: &Rogue, key: &EpochKey) -> Result<gdp::cert::Signed<KeyBox>> {
    let to = (reader.name(), &reader.identity.box_public());
    Ok(keys::wrap(name, &writer.identity, to, 1, key)?)
}

fn store(switch: &Switch, writer: &Identity, boxed: &gdp::cert::Signed<KeyBox>) -> Response {
    switch.ask(Some(&writer.proof()), &EntityRequest::KeyBoxes { boxes: vec![boxed.clone()] })
}

fn sealed(from: &Rogue, name: Name, key: &EpochKey, body: &[u8], to: Name) -> Result<Vec<Frame>> {
    let mut writer = Writer::new(name, from.name(), from.identity.key().clone(), Backend::default())?;
    writer.set_epoch(1, key).context("a first epoch")?;
    from.sealed(&mut writer, from.name(), body, to)
}
