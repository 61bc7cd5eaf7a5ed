//! The back ends of cryptography beside each other, on one CPU. Run by `cargo xtask bench crypto`.
//!
//! - `primitives`: one operation each. What the product takes from RustCrypto alone is compared
//!   with AWS-LC here, so that the choice can be judged.
//! - `messages`: all of a message, from sealing to verifying.

#[path = "../rows/mod.rs"]
mod rows;
#[path = "../sealing/mod.rs"]
mod sealing;

use std::hint::black_box;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, ensure};
use aws_lc_rs::agreement::{self, ECDH_P256, PrivateKey};
use aws_lc_rs::{digest, hkdf};
use clap::Parser;
use gdp_core::crypto::{self, Backend, CryptoError, TAG_LEN};
use gdp_core::identity::SigningKey;
use gdp_e2e::seal::{Draft, Encoding, Reader, Received, Segments, Timestamps, Writer};
use gdp_tests::measure::figure::{Figure, Unit};
use gdp_tests::measure::rounds::{Contender, Sample, alternate};
use gdp_tests::measure::{self, Row, cpu};
use gdp_wire::Name;

use rows::Rows;
use sealing::{PAYLOAD, pair};

#[derive(Parser)]
struct Options {
    #[command(flatten)]
    bench: Bench,
    #[command(flatten)]
    rows: Rows,
}

#[derive(clap::Args)]
struct Bench {
    /// Number of alternating measurements per alternative
    #[arg(long, default_value_t = 7)]
    rounds: usize,
    /// Duration of a measurement, in milliseconds
    #[arg(long, default_value_t = 100)]
    milliseconds: u64,
}

const ROWS: [(&str, Row<Bench>); 2] = [("primitives", primitives), ("messages", messages)];

const RUST_CRYPTO: &str = "RustCrypto";
const AWS_LC: &str = "AWS-LC";

/// A frame's payload of 1500 B, and a large message.
const SIZES: [(usize, &str); 3] = [(64, "64 B"), (1344, "1344 B"), (1 << 20, "1 MiB")];

const MESSAGES: [(usize, &str); 3] = [(64, "64 B"), (8 << 10, "8 KiB"), (1 << 20, "1 MiB")];

fn main() -> Result<()> {
    let Options { bench, rows } = Options::parse();
    measure::run(&bench, &ROWS, &rows.wanted())
}

/// Returns the time of one operation in nanoseconds.
fn time(duration: Duration, mut operation: impl FnMut() -> Result<()>) -> Result<Sample> {
    let start = Instant::now();
    let mut count = 0_u32;
    while count == 0 || start.elapsed() < duration {
        operation()?;
        count += 1;
    }
    Ok(Sample { value: start.elapsed().as_nanos() as f64 / f64::from(count), ..Sample::default() })
}

fn series(backend: Backend) -> &'static str {
    match backend {
        Backend::AwsLc => AWS_LC,
        Backend::RustCrypto => RUST_CRYPTO,
    }
}

fn primitives(bench: &Bench) -> Result<Vec<Figure>> {
    cpu::on(cpu::SENDER, || measure_primitives(bench))
}

fn measure_primitives(bench: &Bench) -> Result<Vec<Figure>> {
    let duration = Duration::from_millis(bench.milliseconds);
    let data: &'static [u8] = vec![0x5a; 1 << 20].leak();
    let key = SigningKey::generate()?;
    let (secret, public) = ([7; 32], key.public());
    let mut contenders = Vec::new();
    let mut add = |series: &'static str, case: String, mut operation: Box<dyn FnMut() -> Result<()>>| {
        contenders.push(Contender::new(series, case, move || time(duration, &mut operation)));
    };
    for (size, label) in SIZES {
        let part = &data[..size];
        let hash = format!("SHA-256, {label}");
        add(RUST_CRYPTO, hash.clone(), Box::new(move || Ok(_ = black_box(crypto::sha256(&[part])))));
        add(AWS_LC, hash, Box::new(move || Ok(_ = black_box(digest::digest(&digest::SHA256, part)))));
        for &backend in Backend::ALL {
            let aead = backend.aead(&secret)?;
            let mut buffer = part.to_vec();
            let seal = move || Ok(_ = black_box(aead.seal(&[0; 12], b"", &mut buffer)?));
            add(series(backend), format!("AES-256-GCM seal, {label}"), Box::new(seal));
            let (aead, mut sealed, mut out) = (backend.aead(&secret)?, part.to_vec(), vec![0; size]);
            let tag: [u8; TAG_LEN] = aead.seal(&[0; 12], b"", &mut sealed)?;
            let open = move || Ok(aead.open(&[0; 12], b"", &sealed, &tag, &mut out)?);
            add(series(backend), format!("AES-256-GCM open, {label}"), Box::new(open));
        }
    }
    for &backend in Backend::ALL {
        let signer = key.signer(backend)?;
        let signature = signer.sign(&data[..32])?;
        let verifier = backend.verifier(&public)?;
        let statement = &data[..32];
        add(series(backend), "ECDSA sign".into(), Box::new(move || Ok(_ = black_box(signer.sign(statement)?))));
        add(series(backend), "ECDSA verify".into(), Box::new(move || Ok(verifier.verify(statement, &signature)?)));
    }
    add(RUST_CRYPTO, "ECDH".into(), Box::new(move || Ok(_ = black_box(crypto::agree(&secret, &public)?))));
    let agree = move || {
        let peer = agreement::UnparsedPublicKey::new(&ECDH_P256, &public[..]);
        let own = PrivateKey::from_private_key(&ECDH_P256, &secret).map_err(|_| anyhow!("no key"))?;
        agreement::agree(&own, peer, CryptoError::BadPublicKey, |x| Ok(_ = black_box(x[0])))?;
        Ok(())
    };
    add(AWS_LC, "ECDH".into(), Box::new(agree));
    let derive = move || Ok(_ = black_box(crypto::hkdf_sha256(&[1; 16], &secret, &[b"info"])?));
    add(RUST_CRYPTO, "HKDF-SHA256".into(), Box::new(derive));
    let derive = move || {
        let mut out = [0; 32];
        let key = hkdf::Salt::new(hkdf::HKDF_SHA256, &[1; 16]).extract(&secret);
        let filled = key.expand(&[b"info"], hkdf::HKDF_SHA256).and_then(|okm| okm.fill(&mut out));
        ensure!(filled.is_ok(), "HKDF failed");
        Ok(_ = black_box(out))
    };
    add(AWS_LC, "HKDF-SHA256".into(), Box::new(derive));
    let measures = alternate(bench.rounds, contenders)?;
    let figure = Figure::new("crypto-primitives", "Time of an operation on one CPU", Unit::Nanoseconds, measures);
    Ok(vec![figure.compare(RUST_CRYPTO, AWS_LC, |_| None)])
}

fn messages(bench: &Bench) -> Result<Vec<Figure>> {
    cpu::on(cpu::SENDER, || measure_messages(bench))
}

fn measure_messages(bench: &Bench) -> Result<Vec<Figure>> {
    let duration = Duration::from_millis(bench.milliseconds);
    let mut contenders = Vec::new();
    for (size, label) in MESSAGES {
        for &backend in Backend::ALL {
            let mut pair = Pair::new(backend)?;
            let body = vec![0x5a; size];
            contenders.push(Contender::new(series(backend), label, move || time(duration, || pair.exchange(&body))));
        }
    }
    let measures = alternate(bench.rounds, contenders)?;
    let title = "Time of sealing, signing, opening and verifying a message on one CPU";
    let figure = Figure::new("crypto-messages", title, Unit::Nanoseconds, measures);
    Ok(vec![figure.compare(RUST_CRYPTO, AWS_LC, |_| None)])
}

/// A writer and a reader with the same back end.
struct Pair {
    writer: Writer,
    reader: Reader,
    from: Name,
    began: Instant,
    segments: Segments,
    received: Received,
}

impl Pair {
    fn new(backend: Backend) -> Result<Self> {
        let (writer, reader, from) = pair(backend)?;
        let (segments, received) = (Segments::new(), Received::default());
        Ok(Self { writer, reader, from, began: Instant::now(), segments, received })
    }

    /// Seals and signs a message, then opens and verifies it.
    fn exchange(&mut self, body: &[u8]) -> Result<()> {
        self.writer.seal_batch(1, &[Draft::new(Encoding::Bytes, body)], PAYLOAD, &mut self.segments)?;
        let now = Timestamps { steady_ns: self.began.elapsed().as_nanos() as u64, unix_ns: 1 };
        self.received.clear();
        for payload in self.segments.iter() {
            let taken = self.reader.push(now, self.from, payload, &mut self.received);
            ensure!(taken.is_ok(), "{taken:?}");
        }
        ensure!(self.received.messages.len() == 1, "the message was not opened");
        Ok(())
    }
}
