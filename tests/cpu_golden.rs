//! The CPU executor against real PyTorch.

#[path = "support/golden.rs"]
mod golden;

use golden::Golden;
use pix2hdr::cpu::{CpuExecutor, Real};
use pix2hdr::network::{Executor, Plan};

/// Largest error as a part of the largest value.
fn error<R: Real>(golden: &Golden) -> f64 {
    let [height, width] = golden.size;
    let plan = Plan::lower_unaligned(&golden.model, height, width).unwrap();
    assert_eq!(plan.result.shape.len(), golden.result.len(), "{}", golden.name);
    let mut result = vec![f32::NAN; golden.result.len()];
    let mut executor = CpuExecutor::<R>::new(plan, golden.calibration.clone());
    executor.run(&golden.measurement, golden.schedule, &mut result).unwrap();
    let largest = golden.result.iter().fold(0.0, |m: f32, v| m.max(v.abs())) as f64;
    let pairs = result.iter().zip(&golden.result);
    let error = pairs.map(|(a, b)| (*a as f64 - *b as f64).abs()).fold(0.0, f64::max);
    error / largest
}

#[test]
fn golden_outputs_are_reproduced() {
    let all = golden::all();
    assert!(all.len() >= 50, "only {} golden cases", all.len());
    for golden in &all {
        let (oracle, fallback) = (error::<f64>(golden), error::<f32>(golden));
        println!("{:30} f64 {oracle:.1e}, f32 {fallback:.1e}", golden.name);
        assert!(oracle <= 1e-6, "{}: f64 is off by {oracle:e} of the largest value", golden.name);
        assert!(fallback <= 1e-4, "{}: f32 is off by {fallback:e} of the largest value", golden.name);
    }
}
