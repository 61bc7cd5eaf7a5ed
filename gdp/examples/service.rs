//! Switches a light on and off. `GDP_KEYRING` and `GDP_SWITCH` say as whom and where.

#[tokio::main]
async fn main() -> Result<(), gdp::Error> {
    let session = gdp::open(gdp::Config::from_env()?).await?;
    let mut server = session.server("/light").await?;
    while let Some(call) = server.recv().await? {
        let reply = format!("the light is {}", String::from_utf8_lossy(call.payload()));
        call.reply(reply).await?;
    }
    Ok(())
}
