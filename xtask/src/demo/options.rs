//! The command-line options of the demo.

#[derive(clap::Args)]
pub struct Options {
    /// Robot, three switches and cloud in a row, instead of the paper's Figure 4
    #[arg(long)]
    pub chain: bool,
    /// Seconds for which messages flow
    #[arg(long, default_value_t = 15)]
    pub seconds: u64,
    /// One JSON object on stdout instead of a story
    #[arg(long)]
    pub json: bool,
    /// Messages per second
    #[arg(long, default_value_t = 50.0)]
    pub rate: f64,
    /// Bytes per message
    #[arg(long, default_value_t = 64)]
    pub size: usize,
}

pub const TEXT: &str = "hello from the robot";
