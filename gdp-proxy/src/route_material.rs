//! The keys and certificates of one route.

use crate::permission::Permission;
use crate::renewal::Renewal;
use crate::ros2::TypeName;
use gdp_core::card::NameCard;
use std::path::Path;

/// The keys and certificates of one direction of a topic, service or action.
#[derive(Clone)]
pub struct RouteMaterial {
    pub card: NameCard,
    /// The ROS type, from the configuration or the card.
    pub kind: Option<TypeName>,
    pub permission: Permission,
    /// The source of renewed certificates.
    pub file: Renewal,
}

/// Returns the type of a topic, service or action, from the configuration or its name card. They
/// must agree if both give one.
pub fn carded_type(
    configured: Option<&TypeName>,
    card: &NameCard,
    path: &Path,
    what: &str,
) -> Result<Option<TypeName>, String> {
    let carded = card.get("type").filter(|text| !text.is_empty()).map(TypeName::parse).transpose();
    let carded = carded.map_err(|error| format!("{}: {error}", path.display()))?;
    match (configured, carded) {
        (Some(configured), Some(carded)) if *configured != carded => Err(format!(
            "{configured}, but the name is of a {what} of {carded} ({}): correct one of them",
            path.display()
        )),
        (configured, carded) => Ok(configured.cloned().or(carded)),
    }
}
