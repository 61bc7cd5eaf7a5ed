//! DPDK's own forwarder, to compare with: it swaps the MAC addresses of what arrives and sends it
//! on, and looks at nothing else.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use gdp_tests::programs::Program;

/// How long it may take to begin, or to answer.
const TIMEOUT: Duration = Duration::from_secs(30);

/// Runs while somebody measures it, and is stopped in between: it never rests by itself.
pub struct Testpmd {
    child: Child,
    input: ChildStdin,
    /// What it says, line by line; who reads it may have to wait without end.
    lines: Receiver<String>,
}

impl Testpmd {
    /// `at`: makes a command where it is to run. Forwards between these devices, or what comes from
    /// one to itself.
    pub fn start(at: impl FnOnce(Program) -> Result<Command>, devices: &[String]) -> Result<Self> {
        // Line by line: otherwise answers would wait for more of them.
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
        // Ends with the child, or with whoever listens.
        let read = move || BufReader::new(output).lines().map_while(Result::ok).try_for_each(|line| sender.send(line));
        std::thread::spawn(read);
        let mut this = Self { child, input, lines };
        this.say("start")?;
        this.frames().context("dpdk-testpmd does not forward")?;
        this.pause(true);
        Ok(this)
    }

    /// Frames per second that it forwards, by its own count.
    pub fn rate(&mut self, duration: Duration) -> Result<f64> {
        self.during(|this| {
            let (start, before) = (Instant::now(), this.frames()?);
            std::thread::sleep(duration);
            Ok((this.frames()? - before) as f64 / start.elapsed().as_secs_f64())
        })
    }

    /// Has it forward while this runs.
    pub fn during<T>(&mut self, run: impl FnOnce(&mut Self) -> T) -> T {
        self.pause(false);
        let result = run(self);
        self.pause(true);
        result
    }

    /// What its first port has received.
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
        // SAFETY: a signal to a child that has not been waited for.
        unsafe { libc::kill(self.child.id() as i32, if pause { libc::SIGSTOP } else { libc::SIGCONT }) };
    }
}

impl Drop for Testpmd {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
