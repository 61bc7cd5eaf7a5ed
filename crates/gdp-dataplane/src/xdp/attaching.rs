//! Puts the program on an interface in the best mode there is, and says why it is not a better one.

use crate::attach_mode::Mode;
use crate::device::Device;
use crate::interface_plane::SUPPORTED;
use crate::kernel::KernelPlane;
use crate::xdp_features::{Features, XdpFeatures};
use crate::{disturbance, kernel_errors};

pub const OCCUPIED: &str = "another XDP program is attached";

pub struct Attacher {
    /// Kernels before 6.3 cannot be asked; there it is assumed that native XDP comes with
    /// redirection.
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

    /// Whether an interface takes redirected frames, if the kernel says.
    pub fn takes_redirects(&self, ifindex: u32) -> Option<bool> {
        self.features(ifindex).map(|features| features.takes_redirects())
    }

    /// The mode that the program has there now, and why it is that.
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

/// Whose program is in the way, and what removes it.
fn occupied(ifindex: u32) -> String {
    match Device::find(ifindex).ok().and_then(|device| device.program) {
        Some(program) => format!("{OCCUPIED}: {program}; {}", program.remedy()),
        None => format!("{OCCUPIED}, and gone by now"),
    }
}
