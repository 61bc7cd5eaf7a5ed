//! Prints three messages of a topic. `GDP_KEYRING` and `GDP_SWITCH` say as whom and where.

use futures::StreamExt as _;

#[tokio::main]
async fn main() -> Result<(), gdp::Error> {
    let session = gdp::open(gdp::Config::from_env()?).await?;
    let mut samples = session.subscriber("/chatter").await?.take(3);
    while let Some(sample) = samples.next().await {
        let sample = sample?;
        println!("{} from {:#}", String::from_utf8_lossy(sample.payload()), sample.source());
    }
    session.close().await
}
