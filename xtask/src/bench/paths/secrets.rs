//! Keys and certificates for the peers that use TLS or DDS Security.

use std::path::Path;
use std::process::Command;

use anyhow::Result;
use gdp_tests::netns::execute;
use gdp_tests::peers::Tls;
use gdp_tests::programs::{Executable as _, Program};

/// Makes a key for an IP address, and a certificate that both ends trust.
pub fn make(host: &str, folder: &Path) -> Result<Tls> {
    let (key, certificate) = (folder.join("peer.key"), folder.join("peer.crt"));
    let mut command = new_key("peer", &key, &certificate);
    command.args(["-addext", &format!("subjectAltName=IP:{host}")]);
    // The self-signed certificate is its own authority. It must not be a CA certificate, because
    // TLS would not accept that for an endpoint.
    execute(command.args(["-addext", "basicConstraints=critical,CA:FALSE"]))?;
    Ok(Tls { key, certificate })
}

/// Returns a command that makes a key on P-256 and a certificate for it. The certificate is
/// self-signed, unless arguments are added.
pub fn new_key(common_name: &str, key: &Path, certificate: &Path) -> Command {
    let mut command = Program::Openssl.command();
    command.args(["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]);
    command.args(["-subj", &format!("/CN={common_name}")]).arg("-keyout").arg(key).arg("-out").arg(certificate);
    command
}
