//! The files of DDS Security (OMG DDS-SECURITY 1.1) for a robot that publishes and a cloud that
//! reads.
//!
//! One authority signs identities, governance and permissions. The governance has the protection
//! kinds of SROS 2: discovery, submessages and payloads are encrypted, and whole messages signed.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use gdp_tests::netns::execute;
use gdp_tests::programs::{Executable as _, Program};

use super::secrets::new_key;

const GOVERNANCE: &str = "<dds><domain_access_rules><domain_rule>
<domains><id>0</id></domains>
<allow_unauthenticated_participants>false</allow_unauthenticated_participants>
<enable_join_access_control>true</enable_join_access_control>
<discovery_protection_kind>ENCRYPT</discovery_protection_kind>
<liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
<rtps_protection_kind>SIGN</rtps_protection_kind>
<topic_access_rules><topic_rule>
<topic_expression>*</topic_expression>
<enable_discovery_protection>true</enable_discovery_protection>
<enable_liveliness_protection>true</enable_liveliness_protection>
<enable_read_access_control>true</enable_read_access_control>
<enable_write_access_control>true</enable_write_access_control>
<metadata_protection_kind>ENCRYPT</metadata_protection_kind>
<data_protection_kind>ENCRYPT</data_protection_kind>
</topic_rule></topic_access_rules>
</domain_rule></domain_access_rules></dds>
";

/// Returns the permissions of a participant. `right`: `publish` or `subscribe`.
fn permissions(label: &str, right: &str) -> String {
    format!(
        "<dds><permissions><grant name=\"{label}\">
<subject_name>CN={label}</subject_name>
<validity><not_before>2020-01-01T00:00:00</not_before><not_after>2037-01-01T00:00:00</not_after></validity>
<allow_rule>
<domains><id>0</id></domains>
<{right}><topics><topic>rt/chatter*</topic></topics></{right}>
</allow_rule>
<default>DENY</default>
</grant></permissions></dds>
"
    )
}

/// Makes a folder for the robot and one for the cloud, each with what `--security` of the Fast DDS
/// peer reads (`tests/peers/README.md`).
pub fn make(folder: &Path) -> Result<[PathBuf; 2]> {
    let authority = Authority { key: folder.join("authority.key"), certificate: folder.join("authority.crt") };
    let mut command = new_key("authority", &authority.key, &authority.certificate);
    execute(command.args(["-addext", "keyUsage=critical,digitalSignature,keyCertSign"]))?;
    Ok([authority.participant(folder, "robot", "publish")?, authority.participant(folder, "cloud", "subscribe")?])
}

/// The authority for identities and for permissions.
struct Authority {
    key: PathBuf,
    certificate: PathBuf,
}

impl Authority {
    fn participant(&self, folder: &Path, label: &str, right: &str) -> Result<PathBuf> {
        let own = folder.join(format!("{label}-security"));
        fs::create_dir(&own).with_context(|| format!("cannot create {}", own.display()))?;
        let mut command = new_key(label, &own.join("identity.key"), &own.join("identity.crt"));
        command.arg("-CA").arg(&self.certificate).arg("-CAkey").arg(&self.key);
        execute(command.args(["-addext", "basicConstraints=critical,CA:FALSE"]))?;
        let authority = own.join("authority.crt");
        fs::copy(&self.certificate, &authority).with_context(|| format!("cannot write {}", authority.display()))?;
        self.sign(GOVERNANCE, &own.join("governance"))?;
        self.sign(&permissions(label, right), &own.join("permissions"))?;
        Ok(own)
    }

    /// Writes a document, and its S/MIME form beside it.
    fn sign(&self, document: &str, file: &Path) -> Result<()> {
        let (plain, signed) = (file.with_extension("xml"), file.with_extension("p7s"));
        fs::write(&plain, document).with_context(|| format!("cannot write {}", plain.display()))?;
        let mut command = Program::Openssl.command();
        command.args(["smime", "-sign", "-text", "-in"]).arg(&plain).arg("-out").arg(&signed);
        execute(command.arg("-signer").arg(&self.certificate).arg("-inkey").arg(&self.key)).map(drop)
    }
}
