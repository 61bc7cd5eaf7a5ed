//! How a replica proves to etcd who it is, and etcd to the replica.

use std::path::PathBuf;

/// The certificates and the password of a replica; by default there are none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Access {
    /// With `https` endpoints.
    pub tls: Option<Tls>,
    pub login: Option<Login>,
}

/// The files, in PEM, of a connection with TLS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tls {
    /// The certificates of those who may certify members of etcd.
    pub ca: PathBuf,
    pub client: Option<ClientCertificate>,
}

/// The files of the certificate that a replica presents to etcd.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClientCertificate {
    pub cert: PathBuf,
    /// Only its owner may read it.
    pub key: PathBuf,
}

/// A user of etcd.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Login {
    pub user: String,
    /// One line. Only its owner may read it.
    pub password_file: PathBuf,
}
