//! Entities that do what no SDK does.

use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Result, bail};
use gdp::cert::{Advert, RtCert, Signed, issue};
use gdp::control::{Credential, EntityRequest, NameRole, Peers, Record, Response};
use gdp::crypto::Backend;
use gdp::keys::{self, KeyBox};
use gdp::seal::{EpochKey, Limits, Message, Moment, Reader, Received};
use gdp::{Identity, Name};

use super::{Frame, Owner, Switch};

/// An entity that is hosted by the switch.
pub struct Rogue {
    pub identity: Identity,
    serial: u64,
    /// Every box it was ever given, by whomever.
    boxes: Vec<Signed<KeyBox>>,
}

impl Rogue {
    /// Attached, with a key of its own and no rights.
    pub fn attach(switch: &Switch) -> Result<Self> {
        let identity = Identity::generate("proxy")?;
        switch.host(identity.name());
        let claims = RtCert { entity: identity.name(), switch: switch.name(), not_after: unix_now() + 3600 };
        let rt_cert = issue(identity.key(), &claims)?;
        match switch.ask(Some(&identity.proof()), &EntityRequest::Attach { rt_cert, resumes: false }) {
            Response::Attached { serial } => Ok(Self { identity, serial, boxes: Vec::new() }),
            other => bail!("not attached: {other:?}"),
        }
    }

    pub fn name(&self) -> Name {
        self.identity.name()
    }

    /// States its part in the owner's name, with a certificate that says so. The response may be a refusal.
    pub fn state(&mut self, switch: &Switch, owner: &Owner, role: NameRole) -> Result<Response> {
        let credential = match role.is_writer() {
            true => Credential::Writer(owner.ad_cert(self.name())?),
            false => Credential::Reader(owner.grant(self.name())?),
        };
        self.state_with(switch, owner, role, credential)
    }

    /// As [`Self::state`], with this right.
    pub fn state_with(
        &mut self,
        switch: &Switch,
        owner: &Owner,
        role: NameRole,
        credential: Credential,
    ) -> Result<Response> {
        let (advert, proof) = (self.advert(switch, owner, role)?, owner.card.proof());
        let request = match credential {
            Credential::Writer(ad_cert) => EntityRequest::Advertise { proof, ad_cert, advert },
            Credential::Reader(grant) => EntityRequest::Subscribe { proof, grant, advert },
        };
        let response = switch.ask(Some(&self.identity.proof()), &request);
        if let Response::Peers(peers) = &response {
            self.take(peers);
        }
        Ok(response)
    }

    /// A record of this entity with that right, as a RIB that lies might give out.
    pub fn record(&mut self, switch: &Switch, owner: &Owner, role: NameRole, credential: Credential) -> Result<Record> {
        let (advert, proof) = (self.advert(switch, owner, role)?, owner.card.proof());
        let (entity, switch) = (self.identity.proof(), switch.name());
        Ok(Record { name: owner.name(), proof, entity, switch, credential, advert, expires_in: 3600 })
    }

    fn advert(&mut self, switch: &Switch, owner: &Owner, role: NameRole) -> Result<Signed<Advert>> {
        self.serial += 1;
        let claims = Advert {
            op: role.op(),
            name: owner.name(),
            entity: self.name(),
            switch: switch.name(),
            serial: self.serial,
            lifetime: 3600,
            box_key: self.identity.box_public(),
        };
        Ok(issue(self.identity.key(), &claims)?)
    }

    fn take(&mut self, peers: &Peers) {
        self.boxes.extend(peers.boxes.iter().cloned());
    }

    /// Takes in what it was told, and returns the frames that came for it.
    pub fn listen(&mut self, switch: &Switch) -> Vec<Frame> {
        let heard = switch.heard(self.name());
        heard.pushes.iter().for_each(|push| self.take(&push.peers));
        heard.frames
    }

    /// Boxes it holds, whoever they are for.
    pub fn boxes(&self) -> &[Signed<KeyBox>] {
        &self.boxes
    }

    /// The keys in its boxes of this writer for this name.
    pub fn keys(&self, name: Name, writer: &Identity) -> Vec<(u32, EpochKey)> {
        let (key, for_us) = (writer.key().verify_key(), (self.name(), self.identity.box_key()));
        let open = |signed| keys::open(signed, name, (writer.name(), &key), for_us).ok();
        self.boxes.iter().filter_map(open).collect()
    }

    /// What it makes of frames to this name from this writer, with all the keys it holds and asking nobody.
    pub fn read(&self, name: Name, writer: &Identity, frames: &[Frame]) -> Result<Vec<Message>> {
        let mut reader = Reader::new(name, Backend::default(), Limits::default());
        reader.authorise(writer.name(), writer.key().verify_key())?;
        reader.vouch_on_sight();
        for (epoch, key) in self.keys(name, writer) {
            reader.set_key(&writer.name(), epoch, key)?;
        }
        let mut received = Received::default();
        let unix = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let now = Moment { steady_ns: 0, unix_ns: unix.as_nanos() as u64 };
        for frame in frames.iter().filter(|frame| frame.destination == name && frame.source == writer.name()) {
            // What does not open is what the test is about.
            let _ = reader.push(now, frame.source, &frame.payload, &mut received);
        }
        Ok(received.messages)
    }
}

fn unix_now() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs())
}
