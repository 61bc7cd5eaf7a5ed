//! The command-line options of the demo.

#[derive(clap::Args)]
pub struct Options {
    /// Use a chain of robot, three switches and cloud, instead of the paper's Figure 4
    #[arg(long)]
    pub chain: bool,
    /// Duration of the traffic, in seconds
    #[arg(long, default_value_t = 15)]
    pub seconds: u64,
    /// Print one JSON object on stdout instead of the text report
    #[arg(long)]
    pub json: bool,
    /// Rate, in messages per second
    #[arg(long, default_value_t = 50.0)]
    pub rate: f64,
    /// Message size, in bytes
    #[arg(long, default_value_t = 64)]
    pub size: usize,
}

pub const TEXT: &str = "hello from the robot";
