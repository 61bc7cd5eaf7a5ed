//! Calls a light. `GDP_KEYRING` and `GDP_SWITCH` say as whom and where.

#[tokio::main]
async fn main() -> Result<(), gdp::Error> {
    let session = gdp::open(gdp::Config::from_env()?).await?;
    let light = session.client("/light").await?;
    let reply = light.call("on").await?;
    println!("{}", String::from_utf8_lossy(reply.payload()));
    session.close().await
}
