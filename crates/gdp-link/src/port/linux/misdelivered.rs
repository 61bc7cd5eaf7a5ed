//! Queues QUIC packets that arrived at the socket for data frames.
//!
//! The kernel sometimes joins a datagram with one for the other socket. Such datagrams are rare.
//! The queue is bounded; excess datagrams are dropped.

use std::collections::VecDeque;
use std::io::IoSliceMut;
use std::net::SocketAddr;
use std::task::{Context, Waker};

use parking_lot::Mutex;
use quinn::udp::{EcnCodepoint, RecvMeta};

use crate::port::batch::UDP_MTU;

/// Queue length, and maximum length of a packet. No link carries longer datagrams.
const QUEUE: usize = 1024;
const LONGEST: usize = UDP_MTU as usize;

/// QUIC packets that the data thread received. QUIC retransmits those that are dropped here.
#[derive(Default)]
pub struct Packets(Mutex<Waiting>);

#[derive(Default)]
struct Waiting {
    packets: VecDeque<(SocketAddr, Option<EcnCodepoint>, Vec<u8>)>,
    /// The waker of the task that takes packets.
    waker: Option<Waker>,
}

impl Packets {
    pub fn put(&self, from: SocketAddr, ecn: Option<EcnCodepoint>, packet: &[u8]) {
        let mut waiting = self.0.lock();
        if waiting.packets.len() < QUEUE && packet.len() <= LONGEST {
            waiting.packets.push_back((from, ecn, packet.to_vec()));
            waiting.waker.iter().for_each(Waker::wake_by_ref);
        }
    }

    /// Moves queued packets into `bufs` while there is space, and returns their number. If there
    /// are none, the task is woken when a packet is queued.
    pub fn take(&self, cx: &Context, bufs: &mut [IoSliceMut<'_>], meta: &mut [RecvMeta]) -> usize {
        let mut waiting = self.0.lock();
        let mut count = 0;
        while count < bufs.len().min(meta.len())
            && let Some((addr, ecn, packet)) = waiting.packets.pop_front()
        {
            let Some(room) = bufs[count].get_mut(..packet.len()) else { continue };
            room.copy_from_slice(&packet);
            meta[count] = RecvMeta { addr, len: packet.len(), stride: packet.len(), ecn, dst_ip: None };
            count += 1;
        }
        if count == 0 && waiting.waker.as_ref().is_none_or(|waker| !waker.will_wake(cx.waker())) {
            waiting.waker = Some(cx.waker().clone());
        }
        count
    }
}
