//! The credentials between a replica and etcd.

use std::path::PathBuf;

/// The TLS settings and the login of a replica; by default it has neither.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Access {
    /// The TLS settings of `https` endpoints.
    pub tls: Option<Tls>,
    pub login: Option<Login>,
}

/// The PEM files of a TLS connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tls {
    /// The certificates of the CAs that sign the certificates of etcd members.
    pub ca: PathBuf,
    pub client: Option<ClientCertificate>,
}

/// The files of the client certificate that a replica presents to etcd.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ClientCertificate {
    pub cert: PathBuf,
    /// The private key. The file must be readable by its owner only.
    pub key: PathBuf,
}

/// An etcd user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Login {
    pub user: String,
    /// The file of the password, one line. It must be readable by its owner only.
    pub password_file: PathBuf,
}
