//! ROS messages for programs of the SDK: `session.ros()`.
//!
//! ```no_run
//! use gdp_ros::sdk::RosSession as _;
//! use gdp_ros::sdk::std_msgs::String;
//!
//! # async fn example() -> Result<(), Box<dyn std::error::Error>> {
//! let session = gdp::open(gdp::Config::from_env()?).await?;
//! let talker = session.ros().publisher::<String>("/chatter").await?;
//! talker.put(&String { data: "hello".into() }).await?;
//!
//! let mut any = session.ros().dynamic_subscriber("/robot7/odom").await?;
//! while let Some(message) = any.recv().await? {
//!     println!("{}: {}", message.type_name, message.value);
//! }
//! # Ok(()) }
//! ```
//!
//! A proxy at the other end makes a ROS publisher of a [`RosPublisher`], with its type, definition
//! and QoS, as if it were a node of ROS. No ROS is needed here.

mod context;
mod dynamic;
mod error;
mod publisher;
mod source;
mod subscriber;
mod types;

use std::path::PathBuf;

use gdp::Session;

use self::context::RosContext;

pub use self::dynamic::{DynamicMessage, DynamicPublisher, DynamicPublisherBuilder, DynamicSubscriber};
pub use self::error::RosSdkError;
pub use self::publisher::{RosPublisher, RosPublisherBuilder};
pub use self::subscriber::{Received, RosSubscriber};
pub use self::types::{RosMessage, builtin_interfaces, geometry_msgs, std_msgs};

/// Adds ROS to a [`Session`].
pub trait RosSession {
    /// Returns the session for ROS messages.
    fn ros(&self) -> Ros;
}

impl RosSession for Session {
    fn ros(&self) -> Ros {
        Ros(RosContext { session: self.clone(), definitions: Vec::new() })
    }
}

/// A session for ROS messages. It knows the common interfaces of ROS 2, and learns others from
/// their publishers.
#[derive(Clone, Debug)]
pub struct Ros(RosContext);

impl Ros {
    /// Also reads the definitions in a share folder of ROS 2, such as `/opt/ros/jazzy/share`, for
    /// types beyond the common interfaces.
    pub fn definitions(mut self, share: impl Into<PathBuf>) -> Self {
        self.0.definitions.push(share.into());
        self
    }

    /// Publishes a topic with messages of `T`. Await the builder.
    pub fn publisher<T: RosMessage>(&self, topic: impl Into<String>) -> RosPublisherBuilder<T> {
        RosPublisherBuilder::new(self.0.clone(), topic.into())
    }

    /// Reads a topic whose messages are of `T`, from publishers of ROS 2 or ROS 1.
    ///
    /// # Errors
    ///
    /// Fails if the keyring has no such topic, or no right to read it.
    pub async fn subscriber<T: RosMessage>(&self, topic: impl Into<String>) -> Result<RosSubscriber<T>, RosSdkError> {
        RosSubscriber::attach(&self.0, topic.into()).await
    }

    /// Publishes a topic with messages of a type that the program names, such as
    /// `std_msgs/msg/String`, from JSON values. Await the builder.
    pub fn dynamic_publisher(&self, topic: impl Into<String>, type_name: impl Into<String>) -> DynamicPublisherBuilder {
        DynamicPublisherBuilder::new(self.0.clone(), topic.into(), type_name.into())
    }

    /// Reads a topic of any type, as JSON values. Publishers say what their types are.
    ///
    /// # Errors
    ///
    /// Fails if the keyring has no such topic, or no right to read it.
    pub async fn dynamic_subscriber(&self, topic: impl Into<String>) -> Result<DynamicSubscriber, RosSdkError> {
        DynamicSubscriber::attach(&self.0, topic.into()).await
    }
}
