//! A camera's response from a recording alone.
//!
//! Neighbouring pixels of different exposure see the same light. So where a scene is static and smooth, R⁻¹(y)/e must
//! not depend on the exposure e, which determines R⁻¹ up to a factor (as for exposure brackets: Debevec and Malik 1997,
//! Mitsunaga and Nayar 1999). What is fitted includes the black level: below it, R⁻¹ is nearly 0.

use super::{Capture, Form, ResponseSpec, SensorError};
use crate::math::spread;

/// Nodes of the fitted curve, closer where it is dark: yᵢ = (i/(n − 1))².
const NODES: usize = 20;
/// Frames that are looked at.
pub(super) const LOOKS: usize = 64;
/// Pixels to each side of which the mean of one exposure is taken.
const RADIUS: usize = 4;
/// Largest deviation over time, in parts of the white level, of a static pixel.
const STATIC: f64 = 0.05;
/// Pixel value from which on a read-out may be saturated.
const SATURATED: f64 = 0.94;
/// Largest change of the mean from pixel to pixel, as a part of it, of a smooth place.
const SMOOTH: f64 = 0.04;
/// Relative difference of two irradiances that counts half.
const HALF: f64 = 0.05;
/// How much a change of slope from node to node, as a part of it, counts beside the mean of the pairs.
const STIFFNESS: f64 = 0.03;
/// Fewest pairs for a fit.
const ENOUGH: usize = 500;

/// A fitted response.
#[derive(Clone, Debug, PartialEq)]
pub struct ResponseFit {
    /// The curve, for a black level of 0.
    pub form: Form,
    /// Median difference of what pixels of different exposure say of the same light, as a part of it: with the capture's
    /// own response, and with the fitted one.
    pub difference: [f64; 2],
    /// Pairs of exposures that were compared.
    pub pairs: usize,
}

/// Two mean pixel values at one place, and how many times as long the second exposure is.
struct Pair {
    short: f64,
    long: f64,
    ratio: f64,
}

impl Capture {
    /// The capture with another response in place of its own and its black level.
    pub fn with_response(mut self, fit: &ResponseFit) -> Result<Self, SensorError> {
        self.info.black_level = 0.0;
        self.info.response = ResponseSpec::Form(fit.form.clone());
        self.response = super::Response::new(fit.form.clone(), self.response.saturation())?;
        Ok(self)
    }
}

/// Fits the response to a capture whose pixels each have one exposure; an error where they don't, or where too little
/// of the scene is static, smooth and well exposed.
pub fn fit_response(capture: &Capture) -> Result<ResponseFit, SensorError> {
    let pairs = pairs(capture)?;
    if pairs.len() < ENOUGH {
        let problem = format!(
            "cannot be fitted: only {} places are static, smooth and well exposed at two exposures ({ENOUGH} are \
             needed)",
            pairs.len()
        );
        return Err(SensorError::Response(problem));
    }
    let (black, white) = (capture.info.black_level, capture.info.white_level);
    let own = |y: f64| capture.response.exposure((y * white - black) / (white - black));
    let mut curve: Vec<f64> = (0..NODES).map(|i| (own(node(i)) / own(1.0)).max(1e-3 * node(i))).collect();
    let before = median_difference(&pairs, &own);
    for _ in 0..30 {
        curve = improved(&curve, &pairs);
    }
    let after = median_difference(&pairs, &|y| at(&curve, y));
    let rows = (0..NODES).map(|i| (curve[i], node(i))).collect();
    Ok(ResponseFit { form: Form::Table(rows), difference: [before, after], pairs: pairs.len() })
}

fn node(i: usize) -> f64 {
    (i as f64 / (NODES - 1) as f64).powi(2)
}

/// Index of the interval that holds `y`, and where in it.
fn interval(y: f64) -> (usize, f64) {
    let i = ((y.max(0.0).sqrt() * (NODES - 1) as f64) as usize).min(NODES - 2);
    (i, ((y - node(i)) / (node(i + 1) - node(i))).clamp(0.0, 1.0))
}

fn at(curve: &[f64], y: f64) -> f64 {
    let (i, part) = interval(y);
    curve[i] + part * (curve[i + 1] - curve[i])
}

fn median_difference(pairs: &[Pair], exposure: &dyn Fn(f64) -> f64) -> f64 {
    let difference = |pair: &Pair| {
        let (short, long) = (exposure(pair.short) * pair.ratio, exposure(pair.long));
        2.0 * (short - long).abs() / (short + long).max(1e-12)
    };
    let mut all: Vec<f64> = pairs.iter().map(difference).collect();
    let middle = all.len() / 2;
    *all.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// One step of iteratively reweighted least squares: Σ ((f(long) − ratio·f(short))/f(long))² over pairs, those that
/// differ much counting less, plus what keeps the slope smooth; f(0) = 0, f(1) = 1, rising.
fn improved(curve: &[f64], pairs: &[Pair]) -> Vec<f64> {
    let mut matrix = vec![[0.0; NODES + 1]; NODES];
    let mut add = |row: &[(usize, f64)], weight: f64| {
        for (i, a) in row {
            for (j, b) in row {
                matrix[*i][*j] += weight * a * b;
            }
        }
    };
    for pair in pairs {
        let size = at(curve, pair.long).max(1e-4);
        let difference = (size - pair.ratio * at(curve, pair.short)) / size;
        let weight = 1.0 / (1.0 + (difference / HALF).powi(2)) / (HALF * size).powi(2) / pairs.len() as f64;
        let ((i, s), (j, l)) = (interval(pair.short), interval(pair.long));
        let short = [(i, -pair.ratio * (1.0 - s)), (i + 1, -pair.ratio * s)];
        add(&[short[0], short[1], (j, 1.0 - l), (j + 1, l)], weight);
    }
    for i in 1..NODES - 1 {
        let [before, behind] = [node(i) - node(i - 1), node(i + 1) - node(i)];
        // Relative to both slopes alike, so that a jump costs as much up as down.
        let slopes = (curve[i] - curve[i - 1]) / before * ((curve[i + 1] - curve[i]) / behind);
        let slope = slopes.sqrt().max(1e-6);
        let row = [
            (i - 1, 1.0 / before / slope),
            (i, -(1.0 / before + 1.0 / behind) / slope),
            (i + 1, 1.0 / behind / slope),
        ];
        add(&row, STIFFNESS);
    }
    // Light and response could be scaled together, so the curve is held where it is known best; and f(0) = 0.
    let mut brightest: Vec<f64> = pairs.iter().map(|pair| pair.long).collect();
    let middle = brightest.len() / 2;
    let (held, _) = interval(*brightest.select_nth_unstable_by(middle, f64::total_cmp).1);
    for (i, value) in [(0, 0.0), (held + 1, curve[held + 1])] {
        const WEIGHT: f64 = 1e9;
        matrix[i][i] += WEIGHT;
        matrix[i][NODES] += WEIGHT * value;
    }
    let mut solved = solve(matrix);
    for i in 1..NODES {
        let least = 1e-3 * (node(i) - node(i - 1));
        solved[i] = solved[i].max(solved[i - 1] + least);
    }
    let last = solved[NODES - 1];
    solved[0] = 0.0;
    solved.into_iter().map(|x| x / last).collect()
}

/// Solves a symmetric, positive definite system; each row ends with its right side.
fn solve(mut rows: Vec<[f64; NODES + 1]>) -> Vec<f64> {
    for i in 0..NODES {
        let pivot = rows[i];
        for row in &mut rows[i + 1..] {
            let factor = row[i] / pivot[i];
            for (value, above) in row.iter_mut().zip(&pivot).skip(i) {
                *value -= factor * above;
            }
        }
    }
    let mut solution = vec![0.0; NODES];
    for i in (0..NODES).rev() {
        let known: f64 = (i + 1..NODES).map(|j| rows[i][j] * solution[j]).sum();
        solution[i] = (rows[i][NODES] - known) / rows[i][i];
    }
    solution
}

/// Places where two exposures can be compared.
fn pairs(capture: &Capture) -> Result<Vec<Pair>, SensorError> {
    let Capture { frames, height, width, .. } = *capture;
    let exposures = exposures(capture)?;
    let mut kinds: Vec<usize> = exposures.clone();
    kinds.sort_unstable();
    kinds.dedup();

    // Mean of each pixel over time, and whether it is static and never saturated.
    let defects = capture.info.defects(&capture.pattern, [height, width])?;
    let mut seen = vec![0.0f64; height * width];
    let (mut sum, mut squares, mut most) =
        (vec![0.0f64; height * width], vec![0.0f64; height * width], vec![0.0f64; height * width]);
    for t in spread(frames, LOOKS) {
        let begin = t * height * width;
        for i in 0..height * width {
            let count = f64::from(capture.counts.value(begin + i));
            if defects.as_ref().is_some_and(|defects| defects.is_none(i, count)) {
                continue;
            }
            let y = count / capture.info.white_level;
            seen[i] += 1.0;
            sum[i] += y;
            squares[i] += y * y;
            most[i] = most[i].max(y);
        }
    }
    for (i, &seen) in seen.iter().enumerate() {
        sum[i] /= seen.max(1.0);
        squares[i] /= seen.max(1.0);
    }
    let usable = |i: usize| most[i] < SATURATED && (squares[i] - sum[i] * sum[i]).max(0.0).sqrt() < STATIC;

    // Mean of each exposure around each pixel; none where one that is not usable is near.
    let local = |kind: usize, y: usize, x: usize| {
        let (mut value, mut weight) = (0.0, 0.0);
        for row in y.saturating_sub(RADIUS)..(y + RADIUS + 1).min(height) {
            for col in x.saturating_sub(RADIUS)..(x + RADIUS + 1).min(width) {
                let i = row * width + col;
                // A pixel that is dead or missing throughout says nothing.
                if exposures[i] != kind || seen[i] == 0.0 {
                    continue;
                }
                if !usable(i) {
                    return None;
                }
                let fall = |a: usize, b: usize| (RADIUS + 1 - a.abs_diff(b)) as f64;
                let w = fall(row, y) * fall(col, x);
                value += w * sum[i];
                weight += w;
            }
        }
        (weight > 0.0).then(|| value / weight)
    };
    let mut pairs = Vec::new();
    for (a, &short) in kinds.iter().enumerate() {
        for &long in &kinds[a + 1..] {
            for (y, x) in (RADIUS..height.saturating_sub(RADIUS + 1))
                .flat_map(|y| (RADIUS..width.saturating_sub(RADIUS + 1)).map(move |x| (y, x)))
            {
                let Some((low, high)) = local(short, y, x).zip(local(long, y, x)) else { continue };
                let Some((right, below)) = local(long, y, x + 1).zip(local(long, y + 1, x)) else { continue };
                if (right - high).abs().max((below - high).abs()) < SMOOTH * high {
                    pairs.push(Pair { short: low, long: high, ratio: long as f64 / short as f64 });
                }
            }
        }
    }
    Ok(pairs)
}

/// The exposure of each pixel.
fn exposures(capture: &Capture) -> Result<Vec<usize>, SensorError> {
    let of = |i: usize| capture.pattern.schedule(i / capture.width, i % capture.width).exposure();
    let all: Option<Vec<usize>> = (0..capture.height * capture.width).map(of).collect();
    all.filter(|all| all.iter().any(|exposure| *exposure != all[0])).ok_or_else(|| {
        SensorError::Response(format!(
            "cannot be fitted to pattern '{}': it needs pixels of different exposure, each with one",
            capture.pattern.name()
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Pattern, Response, Sampler};
    use crate::video::Counts;
    use crate::video::Video;

    /// A static scene whose smooth parts go from dark to bright.
    fn scene() -> Video {
        let frame: Vec<f32> = (0..96 * 96)
            .map(|i| {
                let (y, x) = ((i / 96) as f32, (i % 96) as f32);
                (0.02 * (3.0 * x / 96.0 + 0.3 * (y * 0.1).sin()).exp()).min(1.0)
            })
            .collect();
        Video { frames: 24, height: 96, width: 96, data: frame.repeat(24) }
    }

    fn capture(form: Form, black_level: f64) -> Capture {
        let mut sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), form).unwrap();
        sampler.black_error = black_level;
        sampler.sample(&scene()).unwrap()
    }

    #[test]
    fn an_unknown_response_and_black_level_are_found() {
        let truth = Form::SoftKnee(0.4);
        let mut capture = capture(truth.clone(), 0.02);
        // What the user believes.
        capture.info.response = ResponseSpec::Form(Form::Linear);
        capture.response = Response::new(Form::Linear, 2.0).unwrap();
        let fit = fit_response(&capture).unwrap();
        assert!(fit.difference[0] > 0.05 && fit.difference[1] < 0.02, "{:?}", fit.difference);
        // Up to a factor, since light and response can be scaled together.
        let (fitted, truth) = (Response::new(fit.form, 2.0).unwrap(), Response::new(truth, 2.0).unwrap());
        let ratio = |y: f64| fitted.exposure(y) / truth.exposure(y - 0.02);
        for y in [0.1, 0.2, 0.3, 0.4, 0.6, 0.8] {
            let off = ratio(y) / ratio(0.5);
            assert!((0.93..1.07).contains(&off), "at {y}: {off}");
        }
    }

    /// Dead pixels and missing read-outs say nothing of the response.
    #[test]
    fn values_that_are_none_are_left_out() {
        let sound = capture(Form::Linear, 0.0);
        let expected = fit_response(&sound).unwrap();
        let mut broken = sound.clone();
        let Counts::U16(counts) = &mut broken.counts else { panic!("the simulator writes 16 bits") };
        for (i, count) in counts.iter_mut().enumerate() {
            let pixel = i % (96 * 96);
            if pixel == 40 * 96 + 40 || (i * 2_654_435_761 % 211) == 0 {
                *count = 65535;
            }
        }
        broken.info.dead_pixels = vec![[40, 40]];
        broken.info.missing_count = Some(65535);
        let fit = fit_response(&broken).unwrap();
        assert!(fit.pairs * 10 > expected.pairs * 9, "{} of {} pairs", fit.pairs, expected.pairs);
        assert!((fit.difference[1] - expected.difference[1]).abs() < 0.002, "{:?}", fit.difference);
    }

    #[test]
    fn a_right_response_stays() {
        let fit = fit_response(&capture(Form::Linear, 0.0)).unwrap();
        assert!(fit.difference[1] <= fit.difference[0] + 0.002, "{:?}", fit.difference);
        let Form::Table(rows) = fit.form else { panic!("{:?}", fit.form) };
        for (u, y) in rows.into_iter().filter(|(_, y)| *y > 0.05) {
            assert!((u / y - 1.0).abs() < 0.08, "{u} at {y}");
        }
    }

    #[test]
    fn what_cannot_be_fitted_is_said() {
        let mut moving = scene();
        for t in 0..moving.frames {
            let shift = 7 * t % 96;
            moving.frame_mut(t).rotate_left(shift);
        }
        let sampler = Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap();
        let error = fit_response(&sampler.sample(&moving).unwrap()).unwrap_err().to_string();
        assert!(error.contains("static"), "{error}");
        let global = Sampler::new(Pattern::built_in("global").unwrap(), Form::Linear).unwrap();
        let error = fit_response(&global.sample(&scene()).unwrap()).unwrap_err().to_string();
        assert!(error.contains("different exposure"), "{error}");
    }
}
