//! Names of the files with what the domain's key signed for members, by label, and with what
//! machines ask. The join service watches them.

/// The newest Enrollment of each label.
pub const ENROLLMENTS: &str = "enrollments";

/// The newest RenewalDelegation of each label.
pub const RENEWALS: &str = "renewals";

/// Memberships that the successor of the domain's key signed in exchange for others.
pub const MEMBERSHIPS: &str = "memberships";

/// The applications that wait, which the join service writes.
pub const APPLICATIONS: &str = "applications";

/// The decisions about applications.
pub const DECISIONS: &str = "decisions";
