use std::collections::HashSet;

use naga::valid::Capabilities;

use super::*;
use crate::gpu::shader::validation::validate;
use crate::network::{Model, Plan, Precision, presets};
use crate::sensor::{Form, Pattern, Response};

#[test]
fn workgroups_are_folded_into_two_dimensions() {
    assert_eq!(fold(1, 65535), [1, 1]);
    assert_eq!(fold(65535, 65535), [65535, 1]);
    assert_eq!(fold(65536, 65535), [32768, 2]);
    for count in [0, 1, 7, 999, 1_000_003] {
        let [x, y] = fold(count, 100_000);
        assert!(x <= 100_000 && x as usize * y as usize >= count);
    }
}

/// Adapters, from software with all that it can do to hardware that can do nothing but compute.
fn adapters() -> [(Abilities, Capabilities); 3] {
    let all = Abilities { software: true, subgroup: 8, int64: true, max_workgroups: 65535 };
    // Which every backend has; the name is that of what the web may lack.
    let least = Capabilities::SHADER_FLOAT16_IN_FLOAT32;
    let subgroups = least | Capabilities::SUBGROUP;
    [
        (all, subgroups | Capabilities::SHADER_INT64),
        (Abilities { software: false, subgroup: 32, int64: false, ..all }, subgroups),
        (Abilities { software: false, subgroup: 1, int64: false, ..all }, least),
    ]
}

fn calibration() -> Calibration {
    let pattern = Pattern::built_in("mpve-1-4").unwrap();
    let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).unwrap();
    Calibration::new(&pattern, &response)
}

/// The plan of a preset with random weights, for a few times its granularity.
fn plan(preset: &presets::Preset, times: usize) -> Plan {
    let graph = preset.graph().unwrap();
    let [_, y, x] = graph.granularity().unwrap();
    Plan::lower(&Model::random(graph, 1).unwrap(), times * y, times * x).unwrap()
}

/// What every step of a plan becomes, in every way in which it may be divided.
fn dispatches(plan: &Plan, precision: Precision, abilities: Abilities) -> Vec<Dispatch> {
    let formats = TensorFormats::new(plan, precision);
    let calibration = calibration();
    let of = |step: &Step| {
        let dispatch = |variant| Dispatch::new(step, &formats, &calibration, abilities, variant);
        let chosen = dispatch(None).unwrap();
        let others = chosen.extent.map(|extent| Variant::candidates(extent, abilities)).unwrap_or_default();
        let others: Vec<_> =
            others.into_iter().skip(1).map(|variant| dispatch(Some(variant)).unwrap()).collect();
        [vec![chosen], others].concat()
    };
    plan.steps.iter().flat_map(of).collect()
}

/// Every shader of every preset, at both precisions, on any adapter, in every way in which layers are divided.
#[test]
fn every_shader_of_every_preset_is_valid() {
    let mut known = HashSet::new();
    for preset in presets::all() {
        let plan = plan(&preset, 2);
        for precision in [Precision::F32, Precision::F16] {
            for (abilities, capabilities) in adapters() {
                for Dispatch { kernel, shader, .. } in dispatches(&plan, precision, abilities) {
                    if known.insert(shader.text.clone()) {
                        validate(&shader, capabilities).unwrap_or_else(|problem| {
                            panic!(
                                "{} of {} at {precision:?}, {abilities:?}: {problem}",
                                kernel.name, preset.name
                            )
                        });
                    }
                }
            }
        }
    }
    println!("{} shaders", known.len());
}

/// Sizes of windows and tiles are no part of the text, so that they share pipelines.
#[test]
fn the_size_of_a_window_is_uniform() {
    let (abilities, _) = adapters()[0];
    for preset in presets::all() {
        let [small, large] = [2, 3].map(|times| {
            let plan = plan(&preset, times);
            let formats = TensorFormats::new(&plan, Precision::F32);
            let variant = Some(Variant { pixels: 2, vectors: 1, lanes: 1, wide: false });
            let steps = plan
                .steps
                .iter()
                .map(|step| Dispatch::new(step, &formats, &calibration(), abilities, variant).unwrap());
            steps.collect::<Vec<_>>()
        });
        for (small, large) in small.iter().zip(&large) {
            assert_eq!(small.shader.text, large.shader.text, "{} of {}", small.kernel.name, preset.name);
            assert_ne!(small.shader.uniform(), large.shader.uniform());
        }
    }
}
