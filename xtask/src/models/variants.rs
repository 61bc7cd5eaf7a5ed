//! The protocols, and changed copies of them with the results that these must have.

use anyhow::{Result, ensure};

/// A model that must have no attack.
pub struct Protocol {
    pub file: &'static str,
    /// Concurrent sessions of each principal. Replays need two.
    pub sessions: u8,
}

/// A changed model, with one query.
pub struct Variant {
    /// The file of the model.
    pub of: &'static str,
    pub what: &'static str,
    pub sessions: u8,
    /// Lines, each with its replacement.
    pub edits: &'static [(&'static str, &'static str)],
    pub query: &'static str,
    /// The letter of the query's kind, and 1 if there must be an attack, or 0 if there must be
    /// none.
    pub result: &'static str,
}

impl Variant {
    /// Returns the changed model. Fails if a line to replace does not occur exactly once.
    pub fn apply(&self, model: &str) -> Result<String> {
        let (model, _) = model.split_once("queries[").unwrap_or((model, ""));
        let mut changed = model.to_owned();
        for (from, to) in self.edits {
            ensure!(changed.matches(from).count() == 1, "{}, {}: not one line `{from}`", self.of, self.what);
            changed = changed.replace(from, to);
        }
        Ok(format!("{changed}queries[\n\t{}\n]\n", self.query))
    }
}

pub const PROTOCOLS: [Protocol; 3] = [
    Protocol { file: "message.vp", sessions: 1 },
    Protocol { file: "link.vp", sessions: 1 },
    Protocol { file: "join.vp", sessions: 2 },
];

const TEXT: &str = "confidentiality? text";
const SAME_TEXT: &str = "equivalence? stated, delivered";
const SEALED: &str = "authentication? Writer -> Reader: sealed";
const HELLO: &str =
    "authentication? Dialer -> Listener: dialer_hello[precondition[Listener -> Dialer: listener_hello]]";
const FRAME_KEY: &str = "confidentiality? d_frame_key";
const PROOF: &str = "authentication? Joiner -> Switch: proof[precondition[Switch -> Joiner: admission]]";
const CATALOG: &str = "confidentiality? catalog";

/// A reader passes on the key of the epoch.
const INSIDER: (&str, &str) = ("\tkey_box_sig = SIGN(", "\tleaks epoch_key\n\tkey_box_sig = SIGN(");

const DIALER_STOLEN: (&str, &str) =
    ("\tdialer = PUBKEY(dialer_key)\n", "\tdialer = PUBKEY(dialer_key)\n\tleaks dialer_key\n");

/// The credentials of the dialer, which every peer of it has.
const DIALER_CERT: (&str, &str) = ("\tgenerates dialer_id\n", "\tgenerates dialer_id\n\tleaks dialer_cert\n");

pub const VARIANTS: [Variant; 18] = [
    // Attacks that the design accepts. Each is explained in models/README.md.
    Variant {
        what: "the reader's key is stolen later",
        edits: &[("// End.", "phase[1]\nprincipal Reader[\n\tleaks reader_key\n]\n")],
        ..message(TEXT, "c1")
    },
    Variant { what: "a reader passes on its key of the epoch", edits: &[INSIDER], ..message(TEXT, "c1") },
    Variant {
        what: "the owner's key is stolen",
        edits: &[("\towner = PUBKEY(owner_key)\n", "\towner = PUBKEY(owner_key)\n\tleaks owner_key\n")],
        ..message(TEXT, "c1")
    },
    Variant { what: "a reader seals the same text again", edits: &[INSIDER], ..message(SEALED, "a1") },
    Variant {
        what: "a switch is stolen with its credentials",
        edits: &[
            DIALER_STOLEN,
            DIALER_CERT,
            ("\tleaks dialer_key\n]\nprincipal Listener", "\tstolen = HASH(dialer_key)\n]\nprincipal Listener"),
        ],
        ..link(HELLO, "a1")
    },
    Variant { what: "the line of the invitation is stolen", edits: &[LINE_STOLEN], ..join(PROOF, "a1") },
    Variant {
        what: "the join service is stolen",
        edits: &[("\tservice = PUBKEY(service_key)\n", "\tservice = PUBKEY(service_key)\n\tleaks service_key\n")],
        ..join(CATALOG, "c1")
    },
    // What must hold although a key is stolen.
    Variant {
        what: "the writer's key is stolen later",
        edits: &[("// End.", "phase[1]\nprincipal Writer[\n\tleaks writer_key\n]\n")],
        ..message(TEXT, "c0")
    },
    Variant { what: "a reader cannot write", edits: &[INSIDER], ..message(SAME_TEXT, "e0") },
    // Without one check, its attack must be found.
    Variant {
        what: "no signature of messages",
        edits: &[INSIDER, ("\t_ = SIGNVERIF(writer, r_leaf, r_message_sig)?\n", "")],
        ..message(SAME_TEXT, "e1")
    },
    Variant {
        what: "no grant",
        edits: &[("\t_ = SIGNVERIF(owner, CONCAT(grant_label, name, reader), grant)?\n", "")],
        ..message(TEXT, "c1")
    },
    Variant {
        what: "an AdCert of anybody",
        edits: &[
            ("SIGN(owner_key, CONCAT(ad_cert_label, name, writer))", "SIGN(owner_key, CONCAT(ad_cert_label, name))"),
            ("(owner, CONCAT(ad_cert_label, name, writer), ad_cert)", "(owner, CONCAT(ad_cert_label, name), ad_cert)"),
        ],
        ..message(SEALED, "a1")
    },
    Variant {
        what: "no signature of the key for wrapping",
        edits: &[("\t_ = SIGNVERIF(reader, CONCAT(subscribe_label, name, reader_box), subscribe)?\n", "")],
        ..message(TEXT, "c1")
    },
    Variant {
        what: "no challenge",
        sessions: 2,
        edits: &[("\t_ = ASSERT(r_challenge, challenge)?\n", "")],
        ..message("freshness? sealed", "f1")
    },
    Variant {
        what: "no membership of the dialer",
        edits: &[("\t_ = SIGNVERIF(domain, CONCAT(member_label, domain, dialer, role_switch), l_dialer_cert)?\n", "")],
        ..link(HELLO, "a1")
    },
    Variant {
        what: "no membership of the listener",
        edits: &[(
            "\t_ = SIGNVERIF(domain, CONCAT(member_label, domain, listener, role_switch), d_listener_cert)?\n",
            "",
        )],
        ..link(FRAME_KEY, "c1")
    },
    Variant {
        what: "no signature of the dialer in TLS",
        edits: &[
            DIALER_CERT,
            ("\t_ = SIGNVERIF(dialer, CONCAT(client_context, HASH(l_both, dialer)), dialer_sig)?\n", ""),
        ],
        ..link(HELLO, "a1")
    },
    Variant {
        what: "no signature of the domain on the invitation",
        edits: &[("\t_ = SIGNVERIF(domain, CONCAT(invite_label, domain, j_invite_pk, role), invite)?\n", "")],
        ..join(PROOF, "a1")
    },
];

const LINE_STOLEN: (&str, &str) =
    ("\tj_invite_pk = PUBKEY(invite_key)\n", "\tj_invite_pk = PUBKEY(invite_key)\n\tleaks invite_key\n");

const fn message(query: &'static str, result: &'static str) -> Variant {
    Variant { of: "message.vp", what: "", sessions: 1, edits: &[], query, result }
}

const fn link(query: &'static str, result: &'static str) -> Variant {
    Variant { of: "link.vp", what: "", sessions: 1, edits: &[], query, result }
}

const fn join(query: &'static str, result: &'static str) -> Variant {
    Variant { of: "join.vp", what: "", sessions: 1, edits: &[], query, result }
}
