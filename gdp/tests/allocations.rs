//! Checks that sealing and opening do not allocate per frame.
//!
//! This test is a separate executable because it counts all allocations of the process.

use gdp_core::crypto::Backend;
use gdp_core::identity::Identity;
use gdp_core::keys::EpochKey;
use gdp_e2e::seal::{Draft, Encoding, Reader, ReaderLimits, Received, Segments, Timestamps, Writer};
use gdp_wire::Name;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: all calls are forwarded to the system's allocator. Counting only uses a `const`
// thread-local without a destructor, which itself never allocates.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller guarantees the requirements of `System`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: as above.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above. The memory was allocated by `System`.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn frames_cost_no_allocation() {
    let entity = Identity::generate("proxy").unwrap();
    let (name, epoch_key) = (Name::from_bytes([1; 32]), EpochKey::generate().unwrap());
    let mut writer = Writer::new(name, entity.name(), entity.key().clone(), Backend::selected()).unwrap();
    writer.set_epoch(1, &epoch_key).unwrap();
    let mut reader = Reader::new(name, Backend::selected(), ReaderLimits::default());
    reader.authorise(entity.name(), entity.key().verify_key()).unwrap();
    reader.set_key(&entity.name(), 1, epoch_key).unwrap();
    reader.confirm_session(&entity.name(), writer.session(), 1).unwrap();
    let (mut segments, mut received) = (Segments::new(), Received::default());
    let body = vec![7u8; 200_000];

    // The first call grows the buffers.
    writer.seal(0, Encoding::Bytes, &body, 1400, &mut segments).unwrap();
    push(&mut reader, entity.name(), &segments, &mut received);
    let sealing = allocations(|| writer.seal(0, Encoding::Bytes, &body, 1400, &mut segments).unwrap());
    assert!(segments.len() > 140);
    let opening = allocations(|| push(&mut reader, entity.name(), &segments, &mut received));
    assert_eq!(received.messages.len(), 1);
    // The remaining allocations: the signature (inside the library), and the body and bookkeeping
    // of each message.
    assert!(sealing <= 4, "sealing {} frames: {sealing} allocations", segments.len());
    assert!(opening <= 10, "opening {} frames: {opening} allocations", segments.len());

    // Small messages allocate their bytes. Those with their proof in the next frame also allocate
    // bookkeeping.
    let batch = [Draft::new(Encoding::Bytes, &body[..64]); 256];
    writer.seal_batch(0, &batch, 1400, &mut segments).unwrap();
    push(&mut reader, entity.name(), &segments, &mut received);
    let sealing = allocations(|| writer.seal_batch(0, &batch, 1400, &mut segments).unwrap());
    let opening = allocations(|| push(&mut reader, entity.name(), &segments, &mut received));
    assert_eq!(received.messages.len(), batch.len());
    assert!(sealing <= 4, "sealing {} messages: {sealing} allocations", batch.len());
    assert!(opening <= 3 * batch.len(), "opening {} messages: {opening} allocations", batch.len());
}

fn push(reader: &mut Reader, source: Name, segments: &Segments, received: &mut Received) {
    received.clear();
    for payload in segments.iter() {
        reader.push(Timestamps::default(), source, payload, received).unwrap();
    }
}

fn allocations(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.with(Cell::get);
    work();
    ALLOCATIONS.with(Cell::get) - before
}
