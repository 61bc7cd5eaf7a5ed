//! The node against rosmaster and rospy, as Debian has them, and against peers that mean no good.

mod harness;
mod hostile;
mod master;
mod restart;
mod services;
mod topics;
