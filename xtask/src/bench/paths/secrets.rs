//! A key and its certificate for the peers that use TLS.

use std::path::Path;

use anyhow::Result;
use gdp_tests::netns::execute;
use gdp_tests::peers::Tls;
use gdp_tests::programs::{Executable as _, Program};

/// Makes a key for an IP address, and a certificate that both ends trust.
pub fn make(host: &str, folder: &Path) -> Result<Tls> {
    let (key, certificate) = (folder.join("peer.key"), folder.join("peer.crt"));
    let mut command = Program::Openssl.command();
    command.args(["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]);
    command.args(["-subj", "/CN=peer", "-addext", &format!("subjectAltName=IP:{host}")]);
    // The self-signed certificate is its own authority. It must not be a CA certificate, because
    // TLS would not accept that for an endpoint.
    command.args(["-addext", "basicConstraints=critical,CA:FALSE"]);
    command.arg("-keyout").arg(&key).arg("-out").arg(&certificate);
    execute(&mut command)?;
    Ok(Tls { key, certificate })
}
