//! Publishes a text a second. `GDP_KEYRING` and `GDP_SWITCH` say as whom and where.

use std::time::Duration;

#[tokio::main]
async fn main() -> Result<(), gdp::Error> {
    let session = gdp::open(gdp::Config::from_env()?).await?;
    let publisher = session.publisher("/chatter").reliable().await?;
    publisher.wait_for_readers(1).await?;
    for count in 1..=3 {
        publisher.put(format!("hello {count}")).await?;
        tokio::time::sleep(Duration::from_secs(1)).await;
    }
    session.close().await
}
