//! Whether a changed program computes the same bits as the program before: both do the same on the same inputs, and every
//! file that they write, and what they print as JSON, is compared.

mod cases;
mod compare;
mod recording;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use self::cases::{Case, Inputs, SMALL};
use crate::{Result, cargo, ensure_vulkan, run, target};

/// What is said on the command line.
struct Request {
    old: PathBuf,
    new: Option<PathBuf>,
    recordings: Vec<PathBuf>,
    quick: bool,
}

impl Request {
    fn parse(mut arguments: impl Iterator<Item = String>) -> Option<Self> {
        let mut request =
            Self { old: arguments.next()?.into(), new: None, recordings: Vec::new(), quick: false };
        while let Some(argument) = arguments.next() {
            match argument.as_str() {
                "--new" => request.new = Some(arguments.next()?.into()),
                "--recordings" => request.recordings.push(arguments.next()?.into()),
                "--quick" => request.quick = true,
                _ => return None,
            }
        }
        Some(request)
    }
}

/// Runs all cases with both programs. What differs stays in `target/same-bits`.
pub fn same_bits(root: &Path, arguments: impl Iterator<Item = String>) -> Result<()> {
    let Request { old, new, recordings, quick } = Request::parse(arguments).ok_or(crate::USAGE)?;
    let new = match new {
        Some(new) => new,
        None => build(root)?,
    };
    let [old, new] = [absolute(&old)?, absolute(&new)?];
    if !quick {
        ensure_vulkan()?;
    }
    let work = target(root).join("same-bits");
    if work.exists() {
        fs::remove_dir_all(&work).map_err(|e| format!("{}: {e}", work.display()))?;
    }
    make_cache(&work)?;
    let inputs = inputs(&old, &work, &recordings)?;
    let cases = cases::all(&inputs, quick);
    let (mut differ, mut on_gpu, mut differ_on_gpu) = (0, 0, 0);
    for case in &cases {
        let begun = Instant::now();
        let found = compare(case, &old, &new, &work)?;
        let verdict = if found.is_empty() { "same" } else { "DIFFERS" };
        println!("{verdict:7} {:5.1} s  {}", begun.elapsed().as_secs_f64(), case.name);
        for difference in &found {
            println!("    {difference}");
        }
        on_gpu += usize::from(case.gpu);
        match (found.is_empty(), case.gpu) {
            (true, _) => {}
            (false, true) => differ_on_gpu += 1,
            (false, false) => differ += 1,
        }
    }
    if on_gpu > 0 {
        println!(
            "{on_gpu} more cases on a GPU, where bits are promised for one program only: {differ_on_gpu} differ"
        );
    }
    println!("{} cases, {differ} differ", cases.len() - on_gpu);
    if differ == 0 { Ok(()) } else { Err(format!("what differs is in {}", work.display())) }
}

/// Where drivers keep compiled shaders, for both programs.
const CACHE: &str = "cache";

/// Makes the cache folder. Where the program would keep which kernels are fastest stands a file: then it measures nothing,
/// and always runs the same ones.
fn make_cache(work: &Path) -> Result<()> {
    let folder = work.join(CACHE);
    fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    fs::write(folder.join("pix2hdr"), []).map_err(|e| format!("{}: {e}", folder.display()))
}

/// The program of this tree.
fn build(root: &Path) -> Result<PathBuf> {
    run(cargo().args(["build", "--release", "--package", "pix2hdr", "--bin", "pix2hdr"]).current_dir(root))?;
    Ok(target(root).join("release").join(format!("pix2hdr{}", std::env::consts::EXE_SUFFIX)))
}

/// Makes what cases read, with the old program.
fn inputs(old: &Path, work: &Path, recordings: &[PathBuf]) -> Result<Inputs> {
    let folder = work.join("inputs");
    fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    cases::write_dead_pixels(&folder).map_err(|e| e.to_string())?;
    for arguments in Inputs::commands(recordings.is_empty()) {
        execute(old, &arguments, None, [work, &folder])?;
    }
    let mut names = Vec::new();
    for path in recordings {
        let name = path.file_name().and_then(|name| name.to_str()).ok_or("a recording is a folder")?;
        recording::cut(path, &folder.join(name), [usize::MAX; 3])?;
        names.push(name.to_owned());
    }
    if names.is_empty() {
        names.push("simulated".into());
    }
    for name in &names {
        recording::cut(&folder.join(name), &folder.join(format!("{name}-small")), SMALL)?;
    }
    Ok(Inputs { folder, recordings: names })
}

/// Runs a case with both programs. Returns all differences; without any, its files are removed.
fn compare(case: &Case, old: &Path, new: &Path, work: &Path) -> Result<Vec<String>> {
    // A program sees the same relative paths as the other one, so reports name the same files.
    let folders = ["old", "new"].map(|which| work.join(which).join(case.name.replace(' ', "_")));
    for (program, folder) in [old, new].into_iter().zip(&folders) {
        fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        match execute(program, &case.arguments, case.threads, [work, folder]) {
            Ok(printed) => fs::write(folder.join("printed.json"), printed).map_err(|e| e.to_string())?,
            Err(problem) if program == new && program != old => return Ok(vec![problem]),
            // Two programs that fail alike would be the same.
            Err(problem) => return Err(problem),
        }
    }
    let found = compare::differences(&folders[0], &folders[1])?;
    if found.is_empty() {
        for folder in &folders {
            fs::remove_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        }
    }
    Ok(found)
}

/// Runs a program in a folder below `work`; returns what it prints.
fn execute(
    program: &Path,
    arguments: &[String],
    threads: Option<usize>,
    [work, folder]: [&Path; 2],
) -> Result<Vec<u8>> {
    let mut command = Command::new(program);
    command.args(arguments).arg("--json").current_dir(folder);
    command.env("XDG_CACHE_HOME", work.join(CACHE)).env_remove("RAYON_NUM_THREADS");
    if let Some(threads) = threads {
        command.env("RAYON_NUM_THREADS", threads.to_string());
    }
    let shown = || format!("{} {}", program.display(), arguments.join(" "));
    let output = command.output().map_err(|e| format!("{}: {e}", shown()))?;
    if output.status.success() {
        Ok(output.stdout)
    } else {
        Err(format!("{}: {}\n{}", shown(), output.status, String::from_utf8_lossy(&output.stderr).trim()))
    }
}

fn absolute(program: &Path) -> Result<PathBuf> {
    program.canonicalize().map_err(|e| format!("{}: {e}", program.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_read() {
        let parse = |line: &str| Request::parse(line.split_whitespace().map(str::to_owned));
        let request = parse("a --quick --recordings fan --recordings window --new b").unwrap();
        assert_eq!((request.old.as_path(), request.new.as_deref()), (Path::new("a"), Some(Path::new("b"))));
        assert!(request.quick && request.recordings == [Path::new("fan"), Path::new("window")]);
        for wrong in ["", "a --new", "a b", "a --fast"] {
            assert!(parse(wrong).is_none(), "{wrong}");
        }
    }

    /// A program that is not `pix2hdr`: it writes its last argument but one to a file.
    #[cfg(unix)]
    fn program(name: &str, script: &str) -> PathBuf {
        use std::os::unix::fs::PermissionsExt;
        let folder = std::env::temp_dir().join(format!("pix2hdr-xtask-programs-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join(name);
        fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        path
    }

    #[cfg(unix)]
    #[test]
    fn programs_that_differ_are_found() {
        let one = program("one", "echo 1 > result; echo '{\"frames\": 1, \"seconds\": 1}'");
        let slower = program("slower", "echo 1 > result; echo '{\"frames\": 1, \"seconds\": 2}'");
        let other = program("other", "echo 2 > result; echo '{\"frames\": 2, \"seconds\": 1}'");
        let failing = program("failing", "echo no memory >&2; exit 1");
        let work = one.parent().unwrap().join("work");
        let case = Case { name: "a case".into(), arguments: vec![], threads: Some(1), gpu: false };
        assert_eq!(compare(&case, &one, &one, &work).unwrap(), Vec::<String>::new());
        assert_eq!(compare(&case, &one, &slower, &work).unwrap(), Vec::<String>::new());
        assert_eq!(
            compare(&case, &one, &other, &work).unwrap(),
            ["printed.json: /frames is 2 instead of 1", "result: 1 of 2 bytes differ, the first one at 0"]
        );
        assert!(compare(&case, &one, &failing, &work).unwrap()[0].ends_with("no memory"));
        assert!(compare(&case, &failing, &failing, &work).is_err());
    }
}
