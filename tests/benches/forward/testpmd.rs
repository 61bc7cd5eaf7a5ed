//! DPDK's own forwarder, for comparison. It swaps the MAC addresses of each packet, sends it back
//! out, and examines nothing else.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use gdp_tests::programs::Program;

/// Longest time for start-up and for an answer.
const TIMEOUT: Duration = Duration::from_secs(30);

/// A testpmd process that runs only during measurements. It polls without pause, so it is stopped
/// (SIGSTOP) in between.
pub struct Testpmd {
    child: Child,
    input: ChildStdin,
    /// The lines of its output; reading may block without limit.
    lines: Receiver<String>,
}

impl Testpmd {
    /// Starts testpmd between these devices, or from one device to itself. `at`: returns a command
    /// for the destination namespace.
    pub fn start(at: impl FnOnce(Program) -> Result<Command>, devices: &[String]) -> Result<Self> {
        // Line-buffered: otherwise answers would wait for more output.
        let mut command = at(Program::Stdbuf)?;
        command.args(["-oL", Program::DpdkTestpmd.name()]);
        command.args(["-l", "0,1", "--no-huge", "-m", "256", "--no-pci", "--no-telemetry"]);
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        command.arg(format!("--file-prefix=gdp-testpmd-{}-{number}", std::process::id()));
        devices.iter().for_each(|device| _ = command.arg(format!("--vdev={device}")));
        command.args(["--", "-i", "--forward-mode=macswap", "--nb-cores=1", "--total-num-mbufs=16384"]);
        command.arg(if devices.len() == 1 { "--port-topology=loop" } else { "--port-topology=paired" });
        let piped = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = piped.spawn().context("cannot start dpdk-testpmd")?;
        let (Some(input), Some(output)) = (child.stdin.take(), child.stdout.take()) else { bail!("no pipes") };
        let (sender, lines) = mpsc::channel();
        // The thread ends with the child or with the receiver.
        let read = move || BufReader::new(output).lines().map_while(Result::ok).try_for_each(|line| sender.send(line));
        std::thread::spawn(read);
        let mut this = Self { child, input, lines };
        this.say("start")?;
        this.frames().context("dpdk-testpmd does not forward")?;
        this.pause(true);
        Ok(this)
    }

    /// Returns frames per second by its own count.
    pub fn rate(&mut self, duration: Duration) -> Result<f64> {
        self.during(|this| {
            let (start, before) = (Instant::now(), this.frames()?);
            std::thread::sleep(duration);
            Ok((this.frames()? - before) as f64 / start.elapsed().as_secs_f64())
        })
    }

    /// Runs a closure while testpmd forwards.
    pub fn during<T>(&mut self, run: impl FnOnce(&mut Self) -> T) -> T {
        self.pause(false);
        let result = run(self);
        self.pause(true);
        result
    }

    /// Returns the number of frames that its first port has received.
    fn frames(&mut self) -> Result<u64> {
        self.say("show port stats 0")?;
        let deadline = Instant::now() + TIMEOUT;
        loop {
            let line = match self.lines.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(line) => line,
                Err(RecvTimeoutError::Timeout) => bail!("dpdk-testpmd does not answer"),
                Err(RecvTimeoutError::Disconnected) => bail!("dpdk-testpmd has ended"),
            };
            if let Some((_, rest)) = line.split_once("RX-packets:") {
                return rest.split_whitespace().next().context("no number")?.parse().context("a number");
            }
        }
    }

    fn say(&mut self, what: &str) -> Result<()> {
        writeln!(self.input, "{what}").context("dpdk-testpmd does not listen")
    }

    fn pause(&self, pause: bool) {
        // SAFETY: the signal goes to a child that has not been waited for.
        unsafe { libc::kill(self.child.id() as i32, if pause { libc::SIGSTOP } else { libc::SIGCONT }) };
    }
}

impl Drop for Testpmd {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
