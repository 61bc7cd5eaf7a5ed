//! A ROS listener without ROS. `GDP_KEYRING` and `GDP_SWITCH` say as whom and where.

use gdp_ros::sdk::{RosSession as _, std_msgs};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let session = gdp::open(gdp::Config::from_env()?).await?;
    let mut listener = session.ros().subscriber::<std_msgs::String>("/chatter").await?;
    while let Some(received) = listener.recv().await? {
        println!("{}", received.message.data);
    }
    Ok(session.close().await?)
}
