//! Measures how many signed messages per second one core seals, and how many it opens and verifies.
//!
//! `cargo run --release -p gdp --example seal_rate` prints one line of JSON per batch size. A batch
//! shares one signature. The clock is this thread's CPU time, which other load hardly affects.

use std::time::Duration;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use gdp_core::crypto::Backend;
use gdp_core::identity::Identity;
use gdp_core::keys::EpochKey;
use gdp_e2e::seal::{Draft, Encoding, Reader, ReaderLimits, Received, Segments, Timestamps, Writer};
use gdp_wire::Name;

#[derive(Parser)]
#[command(about = "Measures sealing and opening of signed messages on one core")]
struct Options {
    /// Bytes of a message body
    #[arg(long, default_value_t = 64)]
    bytes: usize,
    /// Bytes of a frame payload
    #[arg(long, default_value_t = 1376)]
    payload: usize,
    /// Messages that share a signature
    #[arg(long, value_delimiter = ',', default_values_t = [1, 4, 16, 64, 256, 1024])]
    batches: Vec<usize>,
    /// How long each direction is measured, in milliseconds
    #[arg(long, default_value_t = 1000)]
    millis: u64,
}

fn main() -> Result<()> {
    let options = Options::parse();
    for &batch in &options.batches {
        let (seal, open, wire_bytes) = measure(&options, batch)?;
        let both = 1.0 / (1.0 / seal + 1.0 / open);
        println!(
            "{{\"batch\": {batch}, \"bytes\": {}, \"wire_bytes\": {wire_bytes}, \"seal_per_s\": {seal:.0}, \
             \"open_per_s\": {open:.0}, \"both_per_s\": {both:.0}}}",
            options.bytes
        );
    }
    Ok(())
}

/// Returns the messages sealed per second, the messages opened per second, and the bytes of frame
/// payload per message.
fn measure(options: &Options, batch: usize) -> Result<(f64, f64, usize)> {
    let (entity, name, key) = (Identity::generate("proxy")?, Name::from_bytes([1; 32]), EpochKey::generate()?);
    let mut writer = Writer::new(name, entity.name(), entity.key().clone(), Backend::selected())?;
    writer.set_epoch(1, &key)?;
    let mut reader = Reader::new(name, Backend::selected(), ReaderLimits::default());
    reader.authorise(entity.name(), entity.key().verify_key())?;
    reader.set_key(&entity.name(), 1, key)?;
    reader.confirm_session(&entity.name(), writer.session(), 1)?;

    let body = vec![0x5a; options.bytes];
    let drafts = vec![Draft::new(Encoding::Bytes, &body); batch];
    let (mut segments, mut received) = (Segments::new(), Received::default());
    let (mut sealing, mut opening) = (Duration::ZERO, Duration::ZERO);
    let (mut messages, mut bytes) = (0, 0);
    let wanted = Duration::from_millis(options.millis);
    while sealing < wanted || opening < wanted {
        let start = on_processor();
        writer.seal_batch(0, &drafts, options.payload, &mut segments)?;
        let sealed = on_processor();
        for payload in segments.iter() {
            reader.push(Timestamps::default(), entity.name(), payload, &mut received)?;
        }
        opening += on_processor() - sealed;
        sealing += sealed - start;
        ensure!(received.messages.len() == batch, "{} of {batch} messages came", received.messages.len());
        received.clear();
        messages += batch;
        bytes += segments.total_bytes();
    }
    let per_second = |time: Duration| messages as f64 / time.as_secs_f64();
    let wire_bytes = bytes.checked_div(messages).context("nothing was sealed")?;
    Ok((per_second(sealing), per_second(opening), wire_bytes))
}

/// Returns the CPU time of this thread.
fn on_processor() -> Duration {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the kernel writes one `timespec` to `time`.
    unsafe { libc::clock_gettime(libc::CLOCK_THREAD_CPUTIME_ID, &mut time) };
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}
