//! Deliberate faults in a copy of the repository, each of which a named test has to catch.
//!
//! Faults in shaders need no compiler: `broken_shaders_are_caught` in `tests/gpu_parity.rs` has those.

use std::env;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use super::{Result, cargo, run, target};

/// A fault, and what has to catch it.
struct Mutant {
    /// The fault in words.
    what: &'static str,
    file: &'static str,
    /// What stands in the file, once.
    sound: &'static str,
    faulty: &'static str,
    /// Test binary (`lib` for unit tests) and test.
    test: [&'static str; 2],
}

const MUTANTS: [Mutant; 31] = [
    Mutant {
        what: "the pixels of an EXR file are put where its display window begins",
        file: "src/video/exr.rs",
        sound: "y as i64 + top",
        faulty: "y as i64 + 0 * top",
        test: ["lib", "video::exr::tests::pixels_lie_at_their_place_in_the_display_window"],
    },
    Mutant {
        what: "the brightest pixel of all says how a contact sheet is exposed",
        file: "src/video/tone_range.rs",
        sound: "(CUT * last as f64) as usize",
        faulty: "(0.0 * CUT * last as f64) as usize",
        test: ["lib", "video::tone_range::tests::single_pixels_move_no_level"],
    },
    Mutant {
        what: "a link to a source is taken for another file",
        file: "src/video/outputs.rs",
        sound: "is_same_file(source, target)\n                ||",
        faulty: "source == target\n                ||",
        test: ["outputs", "no_source_is_a_target"],
    },
    Mutant {
        what: "the pictures of a result are not asked for",
        file: "src/job/sheet.rs",
        sound: "[SHEET].into_iter().chain(skipped)",
        faulty: "[SHEET].into_iter().take(0).chain(skipped)",
        test: ["outputs", "nothing_that_is_there_is_replaced"],
    },
    Mutant {
        what: "placements that change alike, but expose pixels otherwise, are told apart",
        file: "src/sensor/detection/placing.rs",
        sound: "found.is_none() && !self.ambiguous[kind]",
        faulty: "found.is_none()",
        test: ["lib", "sensor::detection::tests::what_is_not_clear_is_not_known"],
    },
    Mutant {
        what: "a pattern that reads out half as often fits too",
        file: "src/sensor/detection/placing.rs",
        sound: "rate(t) >= EVEN * read",
        faulty: "rate(t) >= 0.0",
        test: ["lib", "sensor::detection::tests::what_is_not_clear_is_not_known"],
    },
    Mutant {
        what: "a crop is moved by its place in the pattern's tile alone, not in the net's grid",
        file: "src/synth/on_sensor.rs",
        sound: "tile_origin[axis] % unit[axis]",
        faulty: "tile_origin[axis] % tile[axis]",
        test: ["synthesis", "a_crop_by_any_origin_gives_the_same_bits"],
    },
    Mutant {
        what: "padding is off by one",
        file: "src/cpu/conv3d.rs",
        sound: "origin: -(step.padding[i] as isize)",
        faulty: "origin: 1 - (step.padding[i] as isize)",
        test: ["cpu_convolution", "convolutions_are_their_definition"],
    },
    Mutant {
        what: "rows and columns of kernels are swapped",
        file: "src/network/kernel.rs",
        sound: "* ky + y) * kx + x\n",
        faulty: "* kx + x) * ky + y\n",
        test: ["cpu_convolution", "convolutions_are_their_definition"],
    },
    Mutant {
        what: "a buffer is used again one step too soon",
        file: "src/network/slots.rs",
        sound: "busy_until[tensor.slot] = *tensor.lifetime.end();",
        faulty: "busy_until[tensor.slot] = (*tensor.lifetime.end()).max(1) - 1;",
        test: ["cpu_executor", "slots_and_concatenations_change_nothing"],
    },
    Mutant {
        what: "a piece reads frames of the next one before they are there",
        file: "src/network/pieces.rs",
        sound: "large && read == now",
        faulty: "large",
        test: ["cpu_executor", "pieces_change_nothing"],
    },
    Mutant {
        what: "a piece of rows lacks the rows around it",
        file: "src/network/op/relation.rs",
        sound: "Scale::Down(n) => first * n as isize - before..last * n as isize + after + 1,",
        faulty: "Scale::Down(n) => first * n as isize..last * n as isize + 1,",
        test: ["cpu_executor", "pieces_change_nothing"],
    },
    Mutant {
        what: "a window takes over frames of the one before at the wrong place",
        file: "src/network/lowering.rs",
        sound: "let wanted = frames_from(frames - graph.window.hop - count);",
        faulty: "let wanted = frames_from((frames - graph.window.hop - count).saturating_sub(1));",
        test: ["cpu_executor", "a_window_that_follows_computes_what_is_new_and_the_same"],
    },
    Mutant {
        what: "a pedestal keeps no noise below black",
        file: "src/sensor/sampler.rs",
        sound: "let below_black = x < 0.0 && self.black_level > 0;",
        faulty: "let below_black = false;",
        test: ["lib", "sensor::sampler::tests::a_pedestal_keeps_noise_below_black"],
    },
    Mutant {
        what: "tiles see half of what results depend on",
        file: "src/synth/tiles.rs",
        sound: "let halo = [ry.next_multiple_of(unit[0]), rx.next_multiple_of(unit[1])]",
        faulty: "let halo = [(ry / 2).next_multiple_of(unit[0]), (rx / 2).next_multiple_of(unit[1])]",
        test: ["synthesis", "tiles_equal_the_whole"],
    },
    Mutant {
        what: "windows begin one frame late",
        file: "src/synth/windows.rs",
        sound: "k * window.hop as i64 - window.lead as i64;",
        faulty: "k * window.hop as i64 - window.lead as i64 + 1;",
        test: ["synthesis", "hold_equals_covering"],
    },
    Mutant {
        what: "held read-outs are taken at the wrong phase",
        file: "src/sensor/covering.rs",
        sound: "let covering = pixel.covering(schedule);",
        faulty: "let covering = pixel.covering(schedule + 1);",
        test: ["synthesis", "hold_equals_covering"],
    },
    Mutant {
        what: "a stale cell is kept though its surroundings changed",
        file: "src/synth/skip/gate.rs",
        sound: "changed_at_all(seen, cells, gate.around(k, s), spread)",
        faulty: "changed_at_all(seen, cells, gate.around(k, s), [0, 0])",
        test: ["skipping", "exact_skipping_changes_no_bit"],
    },
    Mutant {
        what: "what f16 cannot hold is not reported",
        file: "shaders/common/convolution.wgsl",
        sound: "if (LIMITED && largest * terms[4 * TERM_VECTORS].x > LIMIT)",
        faulty: "if (LIMITED && largest > 1e38)",
        test: ["gpu_executor", "what_f16_cannot_hold_is_stored_in_other_units"],
    },
    Mutant {
        what: "a shader takes an input that a step does not have for one that it has",
        file: "src/gpu/dispatch.rs",
        sound: "number < step.inputs.len()",
        faulty: "number <= step.inputs.len()",
        test: ["gpu_parity", "conv3d_of_all_sizes"],
    },
    Mutant {
        what: "dead pixels are filled from dead ones",
        file: "src/sensor/defects.rs",
        sound: ".filter(|(pixel, _)| !is_none(*pixel))",
        faulty: "",
        test: ["lib", "sensor::defects::tests::dead_pixels_are_filled_from_pixels_of_the_same_shutter"],
    },
    Mutant {
        what: "a shutter that runs backwards begins where it began",
        file: "src/sensor/symmetry.rs",
        sound: "self.map(0, first.wrapping_add(frames as i64 - 1))",
        faulty: "self.map(0, first)",
        test: ["lib", "sensor::symmetry::tests::mpve_has_eight_symmetries"],
    },
    Mutant {
        what: "results of a view that runs backwards stay so",
        file: "src/synth/ensemble.rs",
        sound: "sums.reverse();",
        faulty: "",
        test: ["ensemble", "an_ensemble_is_the_mean_over_views"],
    },
    Mutant {
        what: "a view has the schedule of the recording",
        file: "src/synth/ensemble.rs",
        sound: "symmetry.beginning(schedule, frames)",
        faulty: "schedule",
        test: ["ensemble", "an_ensemble_is_the_mean_over_views"],
    },
    Mutant {
        what: "a window behind one that moves everywhere is not compared with",
        file: "src/synth/skip/gate.rs",
        sound: "if moved_everywhere {\n                    self.update_whole(k, seen);",
        faulty: "if moved_everywhere {",
        test: ["skipping", "a_scene_that_stops_is_kept_again"],
    },
    Mutant {
        what: "an array's declared size is not held against its file",
        file: "src/video/npy/file.rs",
        sound: "if declared > data_len {",
        faulty: "if declared == u64::MAX {",
        test: ["lib", "video::npy::tests::wrong_headers_are_refused_with_the_cause"],
    },
    Mutant {
        what: "a result with holes counts as complete",
        file: "src/video/folder/writer.rs",
        sound: "(0..self.pushed).find(|&t| !self.folder",
        faulty: "(0..0).find(|&t| !self.folder",
        test: ["faults", "a_picture_is_removed"],
    },
    Mutant {
        what: "two processes may write one result",
        file: "src/job/resumable.rs",
        sound: "match file.try_lock() {",
        faulty: "match file.try_lock_shared() {",
        test: ["faults", "two_processes_write_one_result"],
    },
    Mutant {
        what: "a recording may be written over through a link",
        file: "src/system.rs",
        sound: "identity(a).is_some_and(|a| Some(a) == identity(b))",
        faulty: "a == b && identity(a).is_some()",
        test: ["command_line", "a_source_is_never_its_own_target"],
    },
    Mutant {
        what: "a result is gone on with whatever made it",
        file: "src/fingerprint.rs",
        sound: "difference.before != difference.now",
        faulty: "difference.key.is_empty()",
        test: ["lib", "job::tests::a_job_is_gone_on_with"],
    },
    Mutant {
        what: "frames in Fortran order are read from the wrong place",
        file: "src/video/npy/file.rs",
        sound: "((x * height + y) * frames + first) * size",
        faulty: "((y * width + x) * frames + first) * size",
        test: ["lib", "video::npy::tests::fortran_order_is_read_frame_by_frame"],
    },
];

/// Makes each fault in a copy, or those of which `words` are a part, and runs the test that has to fail.
pub fn mutants(root: &Path, words: Option<&str>) -> Result<()> {
    let mutants: Vec<_> =
        MUTANTS.iter().filter(|mutant| words.is_none_or(|words| mutant.what.contains(words))).collect();
    if mutants.is_empty() {
        return Err(format!("no fault is called '{}'", words.unwrap_or_default()));
    }
    let (copy, build) = (target(root).join("mutants/source"), target(root).join("mutants/target"));
    copy_repository(root, &copy)?;
    let test = |test: [&str; 2], quiet: bool| {
        let mut command = cargo();
        command.args(["test", "--release"]).current_dir(&copy).env("CARGO_TARGET_DIR", &build);
        // Compiled again and again, and run once.
        command.env("CARGO_INCREMENTAL", "1");
        command.args(["--config", "profile.release.package.pix2hdr.opt-level=1"]);
        match test[0] {
            "lib" => command.arg("--lib"),
            name => command.args(["--test", name]),
        };
        if quiet {
            command.stdout(Stdio::null()).stderr(Stdio::null());
        }
        command
    };
    let runs = |mutant: &Mutant, quiet: bool| {
        let mut command = test(mutant.test, quiet);
        command.args([mutant.test[1], "--", "--exact"]);
        command
    };
    // A test that is not there would pass, and one that fails anyway would catch everything.
    for mutant in &mutants {
        let output = runs(mutant, false).stderr(Stdio::inherit()).output().map_err(|e| e.to_string())?;
        let text = String::from_utf8_lossy(&output.stdout);
        if !output.status.success() || !text.contains("1 passed") {
            return Err(format!("without a fault, {} does not pass:\n{text}", mutant.test.join(" ")));
        }
    }
    let mut survivors = Vec::new();
    for mutant in &mutants {
        let path = copy.join(mutant.file);
        let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        if text.matches(mutant.sound).count() != 1 {
            return Err(format!("{} does not hold '{}' once", mutant.file, mutant.sound));
        }
        let write = |text: &str| fs::write(&path, text).map_err(|e| format!("{}: {e}", path.display()));
        write(&text.replace(mutant.sound, mutant.faulty))?;
        // It has to compile: the compiler is not what is being tested.
        let compiled = run(test(mutant.test, false).arg("--no-run"));
        let caught = compiled.and_then(|()| {
            let status = runs(mutant, true).status().map_err(|e| e.to_string())?;
            Ok(!status.success())
        });
        write(&text)?;
        let caught = caught?;
        println!(
            "{}: {} by {}",
            mutant.what,
            if caught { "caught" } else { "MISSED" },
            mutant.test.join(" ")
        );
        if !caught {
            survivors.push(mutant.what);
        }
    }
    println!("\n{} faults, {} missed", mutants.len(), survivors.len());
    if survivors.is_empty() { Ok(()) } else { Err(format!("not caught: {}", survivors.join("; "))) }
}

/// Copies what git tracks, and changes only what differs, so that little is compiled again.
fn copy_repository(root: &Path, copy: &Path) -> Result<()> {
    let listed = Command::new(env::var_os("GIT").unwrap_or_else(|| "git".into()))
        .args(["ls-files", "-z"])
        .current_dir(root)
        .output()
        .map_err(|e| format!("git ls-files: {e}"))?;
    if !listed.status.success() {
        return Err("git ls-files failed; mutants need a git checkout".into());
    }
    let text = String::from_utf8_lossy(&listed.stdout);
    for name in text.split('\0').filter(|name| !name.is_empty()) {
        let (from, to) = (root.join(name), copy.join(name));
        let content = fs::read(&from).map_err(|e| format!("{}: {e}", from.display()))?;
        if fs::read(&to).is_ok_and(|there| there == content) {
            continue;
        }
        let folder = to.parent().unwrap_or(copy);
        fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        fs::write(&to, content).map_err(|e| format!("{}: {e}", to.display()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_can_still_be_made() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        for Mutant { what, file, sound, faulty, .. } in MUTANTS {
            let text = fs::read_to_string(root.join(file)).unwrap();
            assert_eq!(text.matches(sound).count(), 1, "{what}: {file} does not hold '{sound}' once");
            assert_ne!(sound, faulty, "{what}");
        }
    }

    /// A run of all faults takes an hour; a name that was mistyped is found here.
    #[test]
    fn tests_that_catch_faults_exist() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
        for Mutant { what, test: [binary, name], .. } in MUTANTS {
            let parts: Vec<&str> = name.split("::").filter(|part| *part != "tests").collect();
            let (function, modules) = parts.split_last().unwrap();
            let sources = match binary {
                "lib" => {
                    let module = format!("src/{}", modules.join("/"));
                    vec![format!("{module}.rs"), format!("{module}/mod.rs"), format!("{module}/tests.rs")]
                }
                _ => vec![format!("tests/{binary}.rs")],
            };
            let found = sources.iter().any(|source| {
                let text = fs::read_to_string(root.join(source)).unwrap_or_default();
                text.contains(&format!("fn {function}("))
            });
            assert!(found, "{what}: no test {function} in any of {sources:?}");
        }
    }
}
