//! How a schedule goes on through a recording, of which frames may be missing or repeated.

use super::signature::Signature;

/// What a place where frames do not follow each other costs, in frames that speak against it altogether: less is no
/// evidence.
const PRICE: f32 = 4.0;
/// One frame in so many at most may follow a gap: else it is no schedule.
const RARE: usize = 12;

/// A place at which the frames of a recording do not follow each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Gap {
    /// The frame behind it.
    pub frame: usize,
    /// Frames that are missing before that one; −1 if it is the one before it once more.
    pub missing: i64,
}

/// The schedule times of a recording's frames.
#[derive(Clone, Debug)]
pub struct Track {
    /// That of the first frame, in the first period.
    pub start: usize,
    /// Those of all frames.
    pub times: Vec<usize>,
    /// Where they do not follow each other.
    pub gaps: Vec<Gap>,
}

impl Track {
    /// The most likely times of frames that change by `rates`, from the second one on, where `at_readouts` is what classes
    /// change by at a read-out. They begin in `start`, if that is known and nothing is missing soon. Nothing, where too much
    /// is missing to be believed.
    ///
    /// This is Viterbi's algorithm: a state is a time of the period, and a step leads to the next one, at a price to any
    /// other. What changes in a step over missing frames is all that read out in them. As many as the period cannot be told.
    pub fn new<'a>(
        signature: &Signature,
        at_readouts: &[Option<f64>],
        rates: impl Iterator<Item = (usize, &'a [f32])>,
        start: Option<usize>,
    ) -> Option<Self> {
        let period = signature.period;
        let used: Vec<(usize, f64)> =
            at_readouts.iter().enumerate().filter_map(|(class, rate)| Some((class, (*rate)?))).collect();
        if used.is_empty() {
            return None;
        }
        // Which of these classes show a new value in a step of some frames to a time.
        let begins = |time: usize, step: usize| -> Vec<bool> {
            let within = (0..step).map(|back| signature.at(time + period * 2 - back));
            let within: Vec<&[bool]> = within.collect();
            used.iter().map(|&(class, _)| within.iter().any(|begins| begins[class])).collect()
        };
        let steps = period + 1;
        let expected: Vec<Vec<bool>> = (0..period)
            .flat_map(|time| (0..steps).map(move |step| (time, step)))
            .map(|(t, s)| begins(t, s))
            .collect();
        // The start costs as much as a gap if it is another one than said.
        let begun = |time: usize| if start.is_none_or(|start| start % period == time) { 0.0 } else { -PRICE };
        let mut scores: Vec<f32> = (0..period).map(begun).collect();
        let mut taken: Vec<u8> = Vec::new();
        let share = 1.0 / used.len() as f32;
        for (_, rates) in rates {
            let seen: Vec<f32> = used
                .iter()
                .map(|&(class, rate)| (f64::from(rates[class]) / (0.5 * rate).max(1e-12)).min(1.0) as f32)
                .collect();
            let agreement = |expected: &[bool]| {
                let agree = |(&seen, &expected): (&f32, &bool)| if expected { seen } else { 1.0 - seen };
                share * seen.iter().zip(expected).map(agree).sum::<f32>()
            };
            let mut next = Vec::with_capacity(period);
            for time in 0..period {
                let best = (0..steps).map(|step| {
                    let before = (time + 2 * period - step) % period;
                    let price = if step == 1 { 0.0 } else { PRICE };
                    (step, scores[before] - price + agreement(&expected[time * steps + step]))
                });
                let (step, score) = best.max_by(|a, b| a.1.total_cmp(&b.1)).expect("there are steps");
                next.push(score);
                taken.push(step as u8);
            }
            scores = next;
        }
        let last = (0..period).max_by(|&a, &b| scores[a].total_cmp(&scores[b])).unwrap_or(0);
        let frames = taken.len() / period + 1;
        let (mut time, mut back) = (last, Vec::with_capacity(frames));
        for taken in taken.chunks(period).rev() {
            back.push(usize::from(taken[time]));
            time = (time + 2 * period - usize::from(taken[time])) % period;
        }
        let (mut times, mut gaps) = (vec![time], Vec::new());
        for (frame, step) in (1..).zip(back.into_iter().rev()) {
            times.push(times[frame - 1] + step);
            if step != 1 {
                gaps.push(Gap { frame, missing: step as i64 - 1 });
            }
        }
        (gaps.len() * RARE <= frames).then_some(Self { start: time, times, gaps })
    }
}
