//! Project chores: `cargo xtask test`, `test-training`, `mutants`, `fuzz`, `same-bits`, `record` and
//! `results`.

mod mutants;
mod results;
mod same_bits;
#[cfg(test)]
mod structure;

use std::env;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A chore's failure, as a line for the user.
type Result<T> = std::result::Result<T, String>;

const USAGE: &str = "usage: cargo xtask CHORE
       test             formatting, lints and all Rust tests, on software Vulkan if need be
       test-training    the tests of training/, with real PyTorch
       mutants [WORDS]  deliberate faults, each of which a test has to catch; those with WORDS in their name
       fuzz [MINUTES]   broken files for every reader, 5 minutes if nothing else is said
       same-bits OLD_BINARY [--new BINARY] [--recordings FOLDER]... [--quick]
                        whether the program computes the same as an older one, file by file; built if not named
       record NAME -- ARGUMENTS
                        runs the program and keeps what it prints as docs/results/NAME.json
       results [--check]
                        makes the tables of figures in documents from those records";

fn main() -> ExitCode {
    let chore = env::args().nth(1);
    let outcome = match chore.as_deref() {
        Some("test") => test(),
        Some("test-training") => test_training(),
        Some("mutants") => root().and_then(|root| mutants::mutants(&root, env::args().nth(2).as_deref())),
        Some("fuzz") => fuzz(env::args().nth(2)),
        Some("same-bits") => root().and_then(|root| same_bits::same_bits(&root, env::args().skip(2))),
        Some("record") => root().and_then(|root| results::record(&root, env::args().skip(2))),
        Some("results") => root().and_then(|root| results::results(&root, env::args().skip(2))),
        _ => Err(USAGE.into()),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("xtask: {problem}");
            ExitCode::FAILURE
        }
    }
}

/// Formatting, lints, and all tests; ends with one line that counts them.
fn test() -> Result<()> {
    ensure_vulkan()?;
    run(cargo().args(["fmt", "--all", "--check"]))?;
    run(cargo().args(["clippy", "--release", "--workspace", "--all-targets", "--", "-D", "warnings"]))?;
    let mut child = cargo()
        .args(["test", "--release", "--workspace", "--lib", "--bins", "--tests", "--no-fail-fast"])
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|e| format!("cargo test: {e}"))?;
    let (mut passed, mut failed, mut ignored) = (0, 0, 0);
    for line in BufReader::new(child.stdout.take().ok_or("no output")?).lines() {
        let line = line.map_err(|e| e.to_string())?;
        println!("{line}");
        let count = |what: &str| -> usize {
            let before = line.split(what).next().unwrap_or_default();
            before
                .rsplit([' ', '.', ';'])
                .find(|word| !word.is_empty())
                .and_then(|n| n.parse().ok())
                .unwrap_or(0)
        };
        if line.starts_with("test result:") {
            passed += count(" passed");
            failed += count(" failed");
            ignored += count(" ignored");
        }
    }
    let status = child.wait().map_err(|e| e.to_string())?;
    println!("\n{passed} passed, {failed} failed, {ignored} skipped");
    match (status.success(), passed, ignored) {
        (false, ..) => Err(format!("tests failed ({status})")),
        (true, 0, _) => Err("no test ran".into()),
        (true, _, 1..) => Err(format!("{ignored} tests were skipped; every test has to run")),
        _ => Ok(()),
    }
}

/// Most kibibytes of address space of a fuzzing run: what takes more is a finding.
const FUZZ_MEMORY: usize = 6 << 20;

/// Feeds broken files to every reader. What does harm is kept in `target/fuzz/findings`.
fn fuzz(minutes: Option<String>) -> Result<()> {
    let minutes = minutes.map_or(Ok(5.0), |text| text.parse::<f64>().map_err(|_| USAGE.to_owned()))?;
    let root = root()?;
    let target = target(&root);
    run(cargo()
        .args([
            "build",
            "--release",
            "--no-default-features",
            "--manifest-path",
            "fuzz/Cargo.toml",
            "--target-dir",
        ])
        .arg(&target)
        .current_dir(&root))?;
    let driver = target.join("release").join(format!("pix2hdr-fuzz{}", env::consts::EXE_SUFFIX));
    let findings = target.join("fuzz/findings");
    let end = Instant::now() + Duration::from_secs_f64(60.0 * minutes.clamp(0.0, 1e6));
    let mut sound = true;
    // Another seed each time, from the clock: a run that a finding ended is followed by another one.
    let since = SystemTime::now().duration_since(UNIX_EPOCH).map_err(|e| e.to_string())?;
    for seed in since.as_secs().. {
        let left = end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            break;
        }
        let minutes = (left.as_secs_f64() / 60.0).min(5.0);
        // A file in memory is read faster than one on a disk.
        let memory = Path::new("/dev/shm");
        let mut command = if cfg!(unix) {
            let mut shell = Command::new("sh");
            shell.args(["-c", &format!("ulimit -v {FUZZ_MEMORY}; exec \"$0\" \"$@\"")]).arg(&driver);
            shell
        } else {
            Command::new(&driver)
        };
        command.args([minutes.to_string(), seed.to_string()]).arg(&findings);
        if memory.is_dir() {
            command.env("TMPDIR", memory);
        }
        sound &= run(&mut command).is_ok();
    }
    if sound { Ok(()) } else { Err(format!("what does harm is in {}", findings.display())) }
}

/// The tests of `training/` in a virtual environment under `target/`.
fn test_training() -> Result<()> {
    let root = root()?;
    let venv = target(&root).join("training-venv");
    let python = venv.join("bin/python");
    if !python.is_file() {
        let made = run(Command::new("python3").args(["-m", "venv"]).arg(&venv));
        if made.is_err() {
            apt_install("python3-venv")?;
            run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&venv))?;
        }
    }
    run(Command::new(&python)
        .args(["-m", "pip", "install", "--quiet", "-e", "training[test]"])
        .current_dir(&root))?;
    run(Command::new(&python).args(["-m", "pytest", "-q", "training/tests"]).current_dir(&root))
}

/// Installs software Vulkan where there is no Vulkan driver at all, so that no GPU test has to be skipped.
fn ensure_vulkan() -> Result<()> {
    if cfg!(not(target_os = "linux")) || has_vulkan_driver() {
        return Ok(());
    }
    println!("no Vulkan driver here; installing software Vulkan");
    apt_install("mesa-vulkan-drivers")?;
    apt_install("libvulkan1")?;
    if has_vulkan_driver() { Ok(()) } else { Err("mesa-vulkan-drivers brought no Vulkan driver".into()) }
}

fn has_vulkan_driver() -> bool {
    let named = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].iter().any(|name| env::var_os(name).is_some());
    let folders = ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d"];
    let holds_driver = |folder: &&str| {
        Path::new(folder).read_dir().is_ok_and(|entries| {
            entries
                .flatten()
                .any(|entry| entry.path().extension().is_some_and(|extension| extension == "json"))
        })
    };
    named || folders.iter().any(holds_driver)
}

/// Installs a Debian or Ubuntu package; elsewhere says what is needed.
fn apt_install(package: &str) -> Result<()> {
    let needed = format!(
        "the tests need the package {package} (Debian, Ubuntu), which could not be installed here; install it, or \
         what your system has in its place (vulkan-swrast on Arch, mesa-vulkan-drivers on Fedora)"
    );
    let apt = |arguments: &[&str]| {
        run(Command::new("apt-get").args(arguments).env("DEBIAN_FRONTEND", "noninteractive"))
    };
    apt(&["update", "-qq"]).and_then(|()| apt(&["install", "-y", "-qq", package])).map_err(|_| needed)
}

/// Runs a command; a failure names it.
fn run(command: &mut Command) -> Result<()> {
    let shown = format!("{command:?}").replace('"', "");
    println!("$ {shown}");
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("{shown}: {status}")),
        Err(error) => Err(format!("{shown}: {error}")),
    }
}

fn cargo() -> Command {
    Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
}

/// The repository.
fn root() -> Result<PathBuf> {
    let xtask = Path::new(env!("CARGO_MANIFEST_DIR"));
    xtask.parent().map(Path::to_owned).ok_or_else(|| "xtask has no parent folder".into())
}

fn target(root: &Path) -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from)
}
