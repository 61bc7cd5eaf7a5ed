//! Catalogs, directories and messages of the join service are as `docs/gdp.cddl` says.

#[path = "../../gdp-core/tests/examples/mod.rs"]
mod examples;
#[path = "../../gdp-core/tests/unit/published_schema.rs"]
mod schema;

use examples::{Parties, sign};
use gdp_core::card::NameCard;
use gdp_core::cert::Issued;
use gdp_directory::catalog::{Catalog, Entry};
use gdp_directory::directory::{CatalogName, Directory, MemberEntry};
use gdp_directory::messages::{Application, Approval, Join, JoinReply, JoinRequest, OfferedCatalog};

#[test]
fn catalogs_and_directories_have_the_published_schema() {
    let parties = Parties::new();
    let valid = |rule: &str, bytes: &[u8]| schema::check(rule, bytes).unwrap_or_else(|error| panic!("{rule}: {error}"));
    let entry = Entry { metadata: card(&parties).metadata().clone(), grants: vec![grant(&parties)] };
    valid("catalog", &Catalog::new(vec![entry]).unwrap().to_bytes().unwrap());
    let member = |catalog| MemberEntry {
        membership: parties.membership(&parties.reader, "viewer"),
        enrollment: sign(parties.domain.key(), &parties.enrollment()),
        catalog,
        grants: vec![grant(&parties)],
    };
    let directory = Directory::new(vec![member(None), member(Some(CatalogName::from(&card(&parties))))]);
    valid("directory", &directory.to_bytes().unwrap());
    let empty = Catalog::new(vec![]).unwrap().to_bytes().unwrap();
    valid("catalog", &empty);
    schema::check("catalog", &directory.to_bytes().unwrap()).unwrap_err();
    schema::check("catalog", &empty[..empty.len() - 1]).unwrap_err();
}

#[test]
fn messages_of_the_join_service_have_the_published_schema() {
    let parties = Parties::new();
    let enrollment = || sign(parties.domain.key(), &parties.enrollment());
    let offered = OfferedCatalog {
        name: CatalogName::from(&card(&parties)),
        right: sign(&parties.owner, &parties.ad_cert()),
        delegation: sign(&parties.owner, &parties.delegation()),
    };
    let join =
        |catalog| Join { membership: parties.membership(&parties.reader, "viewer"), enrollment: enrollment(), catalog };
    let claims = parties.enrollment();
    let application = Application {
        key: parties.invited.verify_key(),
        label: claims.label,
        expose: claims.expose,
        import: claims.import,
        read: claims.read,
    };
    for request in [
        JoinRequest::Join(Box::new(join(None))),
        JoinRequest::Join(Box::new(join(Some(offered)))),
        JoinRequest::Apply(Box::new(application)),
        JoinRequest::Leave,
    ] {
        // A new kind of request needs an example above.
        match request {
            JoinRequest::Join(_) | JoinRequest::Apply(_) | JoinRequest::Leave => {}
        }
        schema::check("join-request", &request.to_bytes().unwrap()).unwrap_or_else(|e| panic!("{request:?}: {e}"));
    }
    let approval = Approval {
        invite: sign(parties.domain.key(), &parties.invite()),
        enrollment: enrollment(),
        call: sign(&parties.service, &parties.delegation()),
    };
    for reply in [
        JoinReply::Joined { directory: Box::new(grant(&parties)), call: Box::new(grant(&parties)) },
        JoinReply::Left,
        JoinReply::Pending,
        JoinReply::Approved(Box::new(approval)),
        JoinReply::Refused("the reason".into()),
    ] {
        // A new kind of reply needs an example above.
        match reply {
            JoinReply::Joined { .. }
            | JoinReply::Left
            | JoinReply::Pending
            | JoinReply::Approved(_)
            | JoinReply::Refused(_) => {}
        }
        schema::check("join-reply", &reply.to_bytes().unwrap()).unwrap_or_else(|e| panic!("{reply:?}: {e}"));
    }
    schema::check("join-reply", &JoinRequest::Leave.to_bytes().unwrap()).unwrap_err();
}

fn card(parties: &Parties) -> NameCard {
    let key = parties.owner.verify_key();
    NameCard::create(key, "topic", "/chatter", "std_msgs/msg/String", Some("n".into())).unwrap()
}

fn grant(parties: &Parties) -> Issued<gdp_core::cert::ReadGrant> {
    sign(&parties.owner, &parties.read_grant()).into()
}
