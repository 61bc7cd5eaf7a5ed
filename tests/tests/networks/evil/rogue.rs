//! Entities with behaviour that no SDK has.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail};
use gdp_core::cert::{Advert, RtCert, Signed, issue};
use gdp_core::crypto;
use gdp_core::crypto::{Backend, TAG_LEN};
use gdp_core::identity::Identity;
use gdp_core::keys::{self, EpochKey, KeyBox};
use gdp_e2e::seal::{Encoding, Message, Reader, ReaderLimits, Received, Segments, Timestamps, Writer};
use gdp_proto::control::{Credential, EntityRequest, NameRole, Peers, Record, Response};
use gdp_wire::Name;

use super::{Frame, Owner, Switch, eventually};

/// Position of the session in a segment's header.
const SESSION: std::ops::Range<usize> = 16..32;

/// An entity that the switch hosts.
pub struct Rogue {
    pub identity: Identity,
    serial: u64,
    /// Every key box that the entity ever received, from any writer.
    boxes: Vec<Signed<KeyBox>>,
}

impl Rogue {
    /// Attaches an entity with a new key and without rights.
    pub fn attach(switch: &Switch) -> Result<Self> {
        Self::attach_as(switch, Identity::generate("proxy")?)
    }

    fn attach_as(switch: &Switch, identity: Identity) -> Result<Self> {
        switch.host(identity.name());
        let claims = RtCert { entity: identity.name(), switch: switch.name(), not_after: unix().as_secs() + 3600 };
        let rt_cert = issue(identity.key(), &claims)?;
        match switch.ask(Some(&identity.proof()), &EntityRequest::Attach { rt_cert, resumes: false, lane: 0 }) {
            Response::Attached { serial } => Ok(Self { identity, serial, boxes: Vec::new() }),
            other => bail!("not attached: {other:?}"),
        }
    }

    pub fn name(&self) -> Name {
        self.identity.name()
    }

    /// States the entity's role for the owner's name, with a matching certificate. The response may
    /// be a refusal.
    pub fn state(&mut self, switch: &Switch, owner: &Owner, role: NameRole) -> Result<Response> {
        let credential = match role.is_writer() {
            true => Credential::Writer(owner.ad_cert(self.name())?),
            false => Credential::Reader(owner.grant(self.name())?),
        };
        self.state_with(switch, owner, role, credential)
    }

    /// Like [`Self::state`], with this credential.
    pub fn state_with(
        &mut self,
        switch: &Switch,
        owner: &Owner,
        role: NameRole,
        credential: Credential,
    ) -> Result<Response> {
        let (advert, proof) = (self.advert(switch, owner, role)?, owner.card.proof());
        let request = match credential {
            Credential::Writer(ad_cert) => EntityRequest::Advertise { proof, ad_cert, advert, everywhere: false },
            Credential::Reader(grant) => EntityRequest::Subscribe { proof, grant, advert, everywhere: false },
        };
        let response = switch.ask(Some(&self.identity.proof()), &request);
        if let Response::Peers(peers) = &response {
            self.take(peers);
        }
        Ok(response)
    }

    /// Returns a record of this entity with this credential, as a lying RIB might send it.
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

    /// Takes in the updates that the entity received, and returns its frames.
    pub fn listen(&mut self, switch: &Switch) -> Vec<Frame> {
        let heard = switch.heard(self.name());
        heard.pushes.iter().for_each(|push| self.take(&push.peers));
        heard.frames
    }

    /// Waits until the entity has received a key of this writer.
    pub fn await_key(&mut self, switch: &Switch, name: Name, writer: &Identity) -> Result<()> {
        eventually("a key for the reader", || {
            self.listen(switch);
            (!self.keys(name, writer).is_empty()).then_some(())
        })
    }

    /// Returns all key boxes of the entity, for any reader.
    pub fn boxes(&self) -> &[Signed<KeyBox>] {
        &self.boxes
    }

    /// Returns this writer's keys for this name from the entity's boxes.
    pub fn keys(&self, name: Name, writer: &Identity) -> Vec<(u32, EpochKey)> {
        let (key, for_us) = (writer.key().verify_key(), (self.name(), self.identity.box_key()));
        let open = |signed| keys::open(signed, name, (writer.name(), &key), for_us).ok();
        self.boxes.iter().filter_map(open).collect()
    }

    /// Reads frames to this name from this writer, with all keys of the entity and without asking
    /// the RIB.
    pub fn read(&self, name: Name, writer: &Identity, frames: &[Frame]) -> Result<Vec<Message>> {
        let mut reader = Reader::new(name, Backend::selected(), ReaderLimits::default());
        reader.authorise(writer.name(), writer.key().verify_key())?;
        for (epoch, key) in self.keys(name, writer) {
            reader.set_key(&writer.name(), epoch, key)?;
        }
        let mut received = Received::default();
        let now = Timestamps { steady_ns: 0, unix_ns: unix().as_nanos() as u64 };
        for frame in frames.iter().filter(|frame| frame.destination == name && frame.source == writer.name()) {
            let session = frame.payload.get(SESSION).and_then(|session| session.try_into().ok());
            session.map(|session| reader.confirm_session(&writer.name(), session, 0)).transpose()?;
            // The tests are about frames that do not open.
            let _ = reader.push(now, frame.source, &frame.payload, &mut received);
        }
        Ok(received.messages)
    }

    /// Attaches the entity again, after the RIB or the switch forgot it.
    pub fn again(&self, switch: &Switch) -> Result<Self> {
        let mut again = Self::attach_as(switch, self.identity.clone())?;
        again.serial = self.serial;
        again.boxes = self.boxes.clone();
        Ok(again)
    }

    /// Returns a message sealed by `writer`, in frames from `source`.
    pub fn sealed(&self, writer: &mut Writer, source: Name, body: &[u8], to: Name) -> Result<Vec<Frame>> {
        let mut segments = Segments::new();
        writer.seal(unix().as_nanos() as u64, Encoding::Bytes, body, 1000, &mut segments)?;
        Ok(frames(&segments, writer.name(), source, to))
    }

    /// Returns a copy of a one-message frame with another body, `ahead` messages later. The entity
    /// seals it with its epoch's key, which it has, for the frame's session. The signature stays
    /// unchanged. The code follows docs/wire-format.md alone, because no SDK does this.
    pub fn resealed(&self, honest: &Frame, (name, writer): (Name, &Identity), ahead: u64, to: Name) -> Result<Frame> {
        let (backend, mut rest) = (Backend::selected(), &honest.payload[..]);
        let (session, epoch) = (&honest.payload[16..32], &honest.payload[40..44]);
        let key = self.epoch_key(name, writer, epoch)?;
        let of = writer.name();
        let info: [&[u8]; 3] = [b"gdp/session/1", name.as_bytes(), of.as_bytes()];
        let aead = backend.aead(&*crypto::hkdf_sha256(session, &key, &info)?)?;
        let mut payload = Vec::new();
        while let Some((clear, behind)) = rest.split_first_chunk::<44>() {
            let (sealed, behind) = behind.split_at(u16::from_be_bytes([clear[2], clear[3]]).into());
            rest = behind;
            let (ciphertext, tag) = sealed.split_last_chunk::<TAG_LEN>().context("no tag")?;
            let mut plaintext = vec![0; ciphertext.len()];
            aead.open(&nonce(clear), clear, ciphertext, tag, &mut plaintext)?;
            let mut clear = *clear;
            let mut sequence = [0; 8];
            sequence[2..].copy_from_slice(&clear[8..14]);
            clear[8..14].copy_from_slice(&(u64::from_be_bytes(sequence) + ahead).to_be_bytes()[2..]);
            let size = u32::from_be_bytes([clear[36], clear[37], clear[38], clear[39]]) as usize;
            plaintext.get_mut(12..size).context("no message of one segment")?.fill(b'!');
            let tag = aead.seal(&nonce(&clear), &clear, &mut plaintext)?;
            [&clear[..], &plaintext, &tag].iter().for_each(|part| payload.extend_from_slice(part));
        }
        Ok(Frame { payload, to: vec![to], ..honest.clone() })
    }

    /// Returns the key from the box of this epoch.
    fn epoch_key(&self, name: Name, writer: &Identity, epoch: &[u8]) -> Result<Vec<u8>> {
        let of_epoch = |claims: &KeyBox| {
            (claims.name, claims.writer, claims.reader) == (name, writer.name(), self.name())
                && claims.epoch.to_be_bytes() == epoch
        };
        let mut boxes = self.boxes.iter().filter_map(|signed| signed.claims_unverified().ok());
        let claims = boxes.find(of_epoch).context("no box of this epoch")?;
        let der = self.identity.key().pkcs8_der();
        // RFC 5915: the private key is an octet string of 32 bytes after the version.
        let behind = der.windows(5).position(|window| window == [2, 1, 1, 4, 32]).context("not a P-256 key")? + 5;
        let mut secret = [0; 32];
        secret.copy_from_slice(&der[behind..behind + 32]);
        let box_secret = crypto::hkdf_sha256(&[], &secret, &[b"gdp/box-key/1", &[0]])?;
        let names = [name, writer.name(), self.name()].map(|name| *name.as_bytes());
        let info = [b"gdp/key-box/1", names.as_flattened(), epoch].concat();
        Ok(crypto::hpke_open(&box_secret, &info, &claims.sealed)?.to_vec())
    }
}

/// Returns the frames of sealed segments.
pub fn frames(segments: &Segments, destination: Name, source: Name, to: Name) -> Vec<Frame> {
    let frame = |payload: &[u8]| Frame { destination, source, flags: 0, payload: payload.to_vec(), to: vec![to] };
    segments.iter().map(frame).collect()
}

/// Returns the nonce: sequence number and cut, then the index.
fn nonce(clear: &[u8; 44]) -> [u8; 12] {
    let mut nonce = [0; 12];
    nonce[..8].copy_from_slice(&clear[8..16]);
    nonce[8..].copy_from_slice(&clear[4..8]);
    nonce
}

fn unix() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}
