//! A ROS talker without ROS. `GDP_KEYRING` and `GDP_SWITCH` say as whom and where.

use gdp_ros::sdk::{RosSession as _, std_msgs};

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let session = gdp::open(gdp::Config::from_env()?).await?;
    let talker = session.ros().publisher::<std_msgs::String>("/chatter").await?;
    for count in 1.. {
        talker.put(&std_msgs::String { data: format!("hello {count}") }).await?;
        tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    }
    Ok(session.close().await?)
}
