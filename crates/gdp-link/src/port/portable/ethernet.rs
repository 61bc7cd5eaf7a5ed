//! Raw Ethernet, which only Linux has: everything fails with the remedy.

use std::io::{self, IoSliceMut};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use gdp_wire::Name;
use quinn::udp::{RecvMeta, Transmit};
use quinn::{AsyncUdpSocket, UdpPoller};

use crate::port::LinkAddr;
use crate::port::interface::Interface;

/// Fails: interfaces have no index here.
pub fn index_of(_: &str) -> io::Result<u32> {
    Err(unsupported("a link over one interface needs Linux; leave out `%INTERFACE`, or use a link udp:// or tls://"))
}

/// Fails: there are no links over raw Ethernet here.
pub fn find(_: &str) -> io::Result<Interface> {
    Err(no_ethernet())
}

pub fn no_ethernet() -> io::Error {
    unsupported("a link over raw Ethernet needs Linux; use a link udp:// or tls://")
}

fn unsupported(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::Unsupported, why)
}

/// The socket for control frames, of which there is none.
#[derive(Debug)]
pub enum ControlSocket {}

impl ControlSocket {
    pub fn open(_: &Interface, _: u16, _: Option<Name>) -> io::Result<Self> {
        Err(no_ethernet())
    }

    pub async fn discover(&self, _: Option<Name>, _: Duration) -> Vec<(LinkAddr, Name)> {
        match *self {}
    }
}

impl AsyncUdpSocket for ControlSocket {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        match *self {}
    }

    fn try_send(&self, _: &Transmit) -> io::Result<()> {
        match *self {}
    }

    fn poll_recv(&self, _: &mut Context, _: &mut [IoSliceMut<'_>], _: &mut [RecvMeta]) -> Poll<io::Result<usize>> {
        match *self {}
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        match *self {}
    }
}
