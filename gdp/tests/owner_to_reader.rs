//! Uses the public API from end to end, without a network.
//!
//! An owner creates a name and authorises a writer and a reader. A RIB verifies both, and a message
//! is sealed and opened.

use gdp_core::card::NameCard;
use gdp_core::cert;
use gdp_core::cert::{AdCert, Advert, AdvertOp, CertError, Grantee, Issued, ReadGrant, Requester, Signed};
use gdp_core::crypto::Backend;
use gdp_core::identity::{Identity, SigningKey};
use gdp_core::keys::EpochKey;
use gdp_e2e::seal::{Encoding, Reader, ReaderLimits, Received, Segments, Timestamps, Writer};
use gdp_wire::Name;

const NOW: u64 = 1_800_000_000;

#[test]
fn a_message_crosses_from_an_authorised_writer_to_a_reader() -> anyhow::Result<()> {
    let owner = SigningKey::generate()?;
    let card = NameCard::create(owner.verify_key(), "topic", "/chatter", "std_msgs/msg/String", None)?;
    let (writer, reader) = (Identity::generate("proxy")?, Identity::generate("proxy")?);
    let switch = Identity::generate("switch")?.name();

    let (name, not_before, not_after) = (card.name(), NOW, NOW + 3600);
    let (scope, serial) = (vec![], NOW * 1_000_000_000);
    let ad_cert = AdCert { name, entity: writer.name(), scope, serial, not_before, not_after };
    let ad_cert = cert::issue(&owner, &ad_cert)?;
    let grant = ReadGrant { name, to: Grantee::Entity(reader.name()), serial, not_before, not_after };
    let grant = cert::issue(&owner, &grant)?.into();
    // Certificates are exchanged as files.
    let ad_cert = Issued::<AdCert>::from_pem(&ad_cert.to_pem())?;

    let publish = statement(&writer, AdvertOp::Publish, name, switch)?;
    let subscribe = statement(&reader, AdvertOp::Subscribe, name, switch)?;
    cert::authorise_advertise(&speaker(&writer, switch), &card.proof(), &ad_cert, &publish, None)?;
    cert::authorise_subscribe(&speaker(&reader, switch), &card.proof(), &grant, &subscribe, None)?;
    // The reader's certificate authorises neither the reader nor any other entity as a writer.
    let refused = cert::authorise_advertise(&speaker(&reader, switch), &card.proof(), &ad_cert, &subscribe, None);
    assert!(matches!(refused, Err(CertError::WrongEntity { .. })), "{refused:?}");

    let epoch_key = EpochKey::generate()?;
    let mut sealing = Writer::new(name, writer.name(), writer.key().clone(), Backend::selected())?;
    sealing.set_epoch(1, &epoch_key)?;
    let mut opening = Reader::new(name, Backend::selected(), ReaderLimits::default());
    opening.authorise(writer.name(), writer.key().verify_key())?;
    opening.set_key(&writer.name(), 1, epoch_key)?;
    opening.confirm_session(&writer.name(), sealing.session(), 1)?;
    let (mut segments, mut received) = (Segments::new(), Received::default());
    let now = Timestamps { steady_ns: 0, unix_ns: NOW * 1_000_000_000 };
    let image = vec![0xab; 1 << 20];
    for body in [b"hello".as_slice(), &image] {
        sealing.seal(NOW * 1_000_000_000, Encoding::Cdr, body, 1400, &mut segments)?;
        for payload in segments.iter() {
            opening.push(now, writer.name(), payload, &mut received)?;
        }
        assert_eq!(received.messages.pop().map(|message| message.body), Some(body.to_vec().into()));
    }
    Ok(())
}

#[test]
fn both_ends_can_live_in_tasks() {
    fn check<T: Send + Sync + 'static>() {}
    check::<Writer>();
    check::<Reader>();
    check::<Segments>();
    check::<Identity>();
    check::<EpochKey>();
    check::<Signed<AdCert>>();
}

fn statement(entity: &Identity, op: AdvertOp, name: Name, switch: Name) -> Result<Signed<Advert>, CertError> {
    let (serial, lifetime, box_key) = (1, 600, entity.box_public());
    cert::issue(entity.key(), &Advert { op, name, entity: entity.name(), switch, serial, lifetime, box_key })
}

fn speaker(entity: &Identity, switch: Name) -> Requester {
    Requester { entity: entity.name(), entity_key: entity.key().verify_key(), switch, floor: 0, now: NOW }
}
