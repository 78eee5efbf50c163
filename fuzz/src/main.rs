//! Random changes to sound files, for as long as one likes, on any toolchain: `cargo xtask fuzz 10`.
//!
//! What panics, hangs or takes too much memory is kept in the folder `findings`, and the run goes on. Prints one line a
//! reader. Arguments: minutes, seed, folder of findings. Or `replay` and a finding, which is read once more; or `seeds`
//! and a folder, to which sound files are written for cargo-fuzz.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use pix2hdr_fuzz::{Desk, Reader, mutate::mutate, seeds};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A file that takes longer hangs the program.
const PATIENCE: Duration = Duration::from_secs(10);
/// Bytes by which one file of at most 1 MiB may raise the largest memory of the process.
const MOST_MEMORY: u64 = 512 << 20;
/// Files that load are seeds too, up to so many.
const MOST_SEEDS: usize = 400;

/// What is being read, and since when.
type Current = Arc<Mutex<Option<(Instant, Reader, Vec<u8>)>>>;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, replay, file] = &arguments[..]
        && replay == "replay"
    {
        return self::replay(Path::new(file));
    }
    if let [_, seeds, folder] = &arguments[..]
        && seeds == "seeds"
    {
        return write_seeds(Path::new(folder));
    }
    let [_, minutes, seed, findings] = &arguments[..] else {
        eprintln!("usage: pix2hdr-fuzz MINUTES SEED FOLDER | replay FILE | seeds FOLDER");
        return ExitCode::FAILURE;
    };
    let (Ok(minutes), Ok(seed)) = (minutes.parse::<f64>(), seed.parse::<u64>()) else {
        eprintln!("pix2hdr-fuzz: minutes and seed are numbers");
        return ExitCode::FAILURE;
    };
    let findings = PathBuf::from(findings);
    std::fs::create_dir_all(&findings).expect("a folder for findings");
    let message: Arc<Mutex<String>> = Arc::default();
    let hook = message.clone();
    std::panic::set_hook(Box::new(move |info| {
        *hook.lock().expect("nobody panics in here") = info.to_string().replace('\n', " ");
    }));
    let current: Current = Arc::default();
    watch(current.clone(), findings.clone());

    let desk = Desk::new().expect("a desk");
    // Where memory runs out, nothing is left to say so: then the file is there.
    println!("files are read in {}", desk.folder().display());
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut known: Vec<Vec<Vec<u8>>> = Reader::ALL.iter().map(|&reader| seeds::of(reader)).collect();
    let mut counts = BTreeMap::<&str, (u64, u64)>::new();
    let mut found = BTreeMap::<String, u64>::new();
    let end = Instant::now() + Duration::from_secs_f64(60.0 * minutes);
    while Instant::now() < end {
        let kind = rng.random_range(0..Reader::ALL.len());
        let (reader, files) = (Reader::ALL[kind], &mut known[kind]);
        let mut data = files[rng.random_range(0..files.len())].clone();
        let other = &files[rng.random_range(0..files.len())];
        mutate(&mut data, other, reader.is_text(), &mut rng);
        let before = peak_memory();
        *current.lock().expect("unpoisoned") = Some((Instant::now(), reader, data.clone()));
        let outcome = catch_unwind(AssertUnwindSafe(|| desk.read(reader, &data)));
        *current.lock().expect("unpoisoned") = None;
        let grown = peak_memory().saturating_sub(before);
        let count = counts.entry(reader.name()).or_default();
        count.0 += 1;
        let problem = match outcome {
            Err(_) => Some(message.lock().expect("unpoisoned").clone()),
            Ok(_) if grown > MOST_MEMORY => Some(format!("{} MiB more memory", grown >> 20)),
            Ok(loads) => {
                count.1 += u64::from(loads);
                if loads && files.len() < MOST_SEEDS && rng.random_range(0..8) == 0 {
                    files.push(data.clone());
                }
                None
            }
        };
        if let Some(problem) = problem {
            let times = found.entry(format!("{}: {problem}", reader.name())).or_default();
            *times += 1;
            if *times == 1 {
                println!("{}: {problem}", reader.name());
                keep(&findings, reader, &data, &format!("{seed}-{}", found.len()));
            }
        }
    }
    for (reader, (files, loaded)) in &counts {
        println!("{reader}: {files} files, {loaded} of them load");
    }
    println!("{} files, {} findings", counts.values().map(|c| c.0).sum::<u64>(), found.len());
    if found.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Writes the sound files of each reader where its target begins: `FOLDER/capture_json/0` ….
fn write_seeds(folder: &Path) -> ExitCode {
    for reader in Reader::ALL {
        let corpus = folder.join(reader.name().replace('-', "_"));
        std::fs::create_dir_all(&corpus).expect("a folder for seeds");
        for (number, seed) in seeds::of(reader).iter().enumerate() {
            std::fs::write(corpus.join(number.to_string()), seed).expect("seeds can be kept");
        }
    }
    ExitCode::SUCCESS
}

/// Reads a finding again; its name begins with that of its reader.
fn replay(file: &Path) -> ExitCode {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    let Some(reader) = Reader::ALL.into_iter().find(|reader| name.starts_with(reader.name())) else {
        eprintln!("pix2hdr-fuzz: '{name}' does not begin with a reader");
        return ExitCode::FAILURE;
    };
    let data = std::fs::read(file).expect("the finding can be read");
    let (before, begun) = (peak_memory(), Instant::now());
    let loads = Desk::new().expect("a desk").read(reader, &data);
    let mib = peak_memory().saturating_sub(before) >> 20;
    println!("{name}: {}, {mib} MiB, {:?}", if loads { "loads" } else { "is refused" }, begun.elapsed());
    ExitCode::SUCCESS
}

/// Ends the process when a file takes too long, after keeping it.
fn watch(current: Current, findings: PathBuf) {
    std::thread::spawn(move || {
        loop {
            std::thread::sleep(Duration::from_secs(1));
            if let Some((begun, reader, data)) = &*current.lock().expect("unpoisoned")
                && begun.elapsed() > PATIENCE
            {
                println!("{}: takes longer than {PATIENCE:?}", reader.name());
                keep(&findings, *reader, data, &format!("hang-{}", std::process::id()));
                std::process::exit(2);
            }
        }
    });
}

fn keep(findings: &Path, reader: Reader, data: &[u8], name: &str) {
    std::fs::write(findings.join(format!("{}-{name}", reader.name())), data).expect("findings can be kept");
}

/// Most bytes of memory that the process ever had; 0 where the system does not tell.
fn peak_memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|line| line.trim().trim_end_matches(" kB").parse::<u64>().ok()).unwrap_or(0) << 10
}
