//! Project chores: `cargo xtask test` and `cargo xtask test-training`.

use std::env;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

/// A chore's failure, as a line for the user.
type Result<T> = std::result::Result<T, String>;

const USAGE: &str = "usage: cargo xtask test            formatting, lints and all Rust tests, on software Vulkan if \
                     need be\n       cargo xtask test-training   the tests of training/, with real PyTorch";

fn main() -> ExitCode {
    let chore = env::args().nth(1);
    let outcome = match chore.as_deref() {
        Some("test") => test(),
        Some("test-training") => test_training(),
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
