//! The node against rosmaster and rospy, as Debian has them, and against peers that mean no good.

mod harness;
mod hostile;
mod restart;
mod services;
mod topics;
