//! Attaches the program to an interface in the best available mode, and gives the reason for any
//! worse mode.

use crate::attach_mode::Mode;
use crate::device::Device;
use crate::interface_plane::SUPPORTED;
use crate::kernel::KernelPlane;
use crate::xdp_features::{Features, XdpFeatures};
use crate::{disturbance, kernel_errors};

pub const OCCUPIED: &str = "another XDP program is attached";

pub struct Attacher {
    /// `None` on kernels before 6.3, which have no such query. Native XDP is then assumed to
    /// support redirection.
    features: Option<XdpFeatures>,
}

impl Default for Attacher {
    fn default() -> Self {
        Self { features: XdpFeatures::open().ok() }
    }
}

impl Attacher {
    fn features(&self, ifindex: u32) -> Option<Features> {
        self.features.as_ref()?.of(ifindex).ok()
    }

    /// Returns whether an interface accepts redirected frames, if the kernel reports it.
    pub fn takes_redirects(&self, ifindex: u32) -> Option<bool> {
        self.features(ifindex).map(|features| features.takes_redirects())
    }

    /// Attaches the program. Returns the resulting mode and the reason for it.
    pub fn attach(&self, kernel: &mut KernelPlane, ifindex: u32, name: &str, named: bool) -> (Option<Mode>, String) {
        match kernel.take_over(ifindex) {
            Ok(Some(mode)) => return (Some(mode), "taken over from the daemon before this one".into()),
            Ok(None) => {}
            Err(error) => {
                tracing::warn!(interface = name, %error, "the program of an earlier daemon cannot be replaced in \
                                                          place");
            }
        }
        if let Some(disturbance) = (!named).then(|| disturbance::of(name, self.features(ifindex))).flatten() {
            return (None, disturbance);
        }
        let native = match kernel.programs.attach(ifindex, Mode::Native) {
            Ok(()) => return (Some(Mode::Native), SUPPORTED.into()),
            Err(error) => error,
        };
        if kernel_errors::is_occupied(&native) {
            return (None, occupied(ifindex));
        }
        let why = kernel_errors::attach(&native);
        if !named {
            return (None, format!("no native XDP: {why}; generic XDP would slow down all that arrives there"));
        }
        match kernel.programs.attach(ifindex, Mode::Generic) {
            Ok(()) => (Some(Mode::Generic), format!("no native XDP: {why}")),
            Err(generic) => {
                (None, format!("no native XDP: {why}; no generic XDP: {}", kernel_errors::attach(&generic)))
            }
        }
    }
}

/// Describes the program that occupies the interface, and the command that removes it.
fn occupied(ifindex: u32) -> String {
    match Device::find(ifindex).ok().and_then(|device| device.program) {
        Some(program) => format!("{OCCUPIED}: {program}; {}", program.remedy()),
        None => format!("{OCCUPIED}, and gone by now"),
    }
}
