//! Where frames lie on the sensor and when their schedule begins, from when pixels change.

use super::changes::Changes;
use super::gaps::Track;
use super::signature::Signature;
use crate::sensor::{Pattern, Placement};

/// Changes that a class has to have before it says anything.
const ENOUGH: u64 = 30;
/// Least part of the most that a class changes by at a time of the period by which it changes less at another one: what it
/// changes by at all times is noise that lossy video adds, and is left out.
const CLEAR: f64 = 0.5;
/// How much a class may change at any time between read-outs, as a part of how much it changes at them, to speak for a candidate; and
/// from where on it speaks against it. Where it does neither, nothing is known.
const FOR: f64 = 0.6;
const AGAINST: f64 = 0.75;
/// How much each read-out of two periods has to change at least, as a part of the mean one: a pattern that reads out half
/// as often would fit too.
const EVEN: f64 = 0.05;
/// Frames that are looked at where some may be missing.
const FRAMES: usize = 2048;

/// A way in which frames can lie on the sensor.
#[derive(Clone, Debug)]
pub struct Candidate {
    pub placement: Placement,
    signature: Signature,
    /// Schedule time of the first frame, if no frame is missing.
    start: usize,
    /// Of classes that say something: how much they change at a read-out on an average.
    rates: Vec<Option<f64>>,
    /// The most that a class changes between read-outs, as a part of that.
    pub leak: f64,
}

/// What the changes of a recording say of a candidate.
enum Verdict {
    /// It fits: what classes change by at read-outs, and how much of that between them.
    For(Vec<Option<f64>>, f64),
    /// It does not fit.
    Against,
    /// Neither.
    Open,
}

/// All ways in which frames can lie on a sensor, those that change alike taken together.
pub struct Placing {
    /// The plainest of each kind, those of all schedule starts taken together.
    kinds: Vec<(Placement, Signature)>,
    /// Of those, the ones whose pixels are exposed in more than one way: changes cannot tell them apart.
    ambiguous: Vec<bool>,
}

impl Placing {
    pub fn new(pattern: &Pattern, grid: usize) -> Self {
        let (mut kinds, mut ambiguous): (Vec<(Placement, Signature)>, Vec<bool>) = Default::default();
        for placement in Placement::all([pattern.rows(), pattern.cols()]) {
            let shown = placement.shown(pattern);
            let signature = Signature::new(&shown, grid);
            let alike = |(_, known): &(Placement, Signature)| {
                (0..signature.period).find(|&start| known.from(start) == signature)
            };
            let known = kinds.iter().enumerate().find_map(|(i, known)| Some((i, alike(known)?)));
            if let Some((i, start)) = known {
                let known = kinds[i].0.shown(pattern);
                ambiguous[i] |= !reads_alike(&known, start as i64, &shown, 0);
            } else {
                kinds.push((placement, signature));
                ambiguous.push(false);
            }
        }
        Self { kinds, ambiguous }
    }

    /// The only candidate that the whole recording speaks for, if there is one and no frame is missing.
    pub fn steady(&self, changes: &Changes) -> Option<Candidate> {
        let candidates = (0..self.kinds.len()).flat_map(|kind| {
            // Starts that change alike are one candidate.
            let signature = &self.kinds[kind].1;
            let starts = 0..signature.period;
            let new = move |&start: &usize| (0..start).all(|s| signature.from(s) != signature.from(start));
            starts.filter(new).map(move |start| (kind, start))
        });
        let verdict = |(kind, start): (usize, usize)| {
            let signature = &self.kinds[kind].1;
            let times = changes.rates().map(|(frame, rates)| (start + frame, rates));
            (kind, start, judge(signature, changes, times))
        };
        self.only(candidates.map(verdict))
    }

    /// The only candidate that the recording speaks for if frames of it are missing.
    pub fn through_gaps(&self, changes: &Changes) -> Option<Candidate> {
        let verdict = |kind: usize| {
            let (_, signature) = &self.kinds[kind];
            let most = changes.rates().fold(vec![0.0f64; signature.classes], |most, (_, rates)| {
                most.iter().zip(rates).map(|(&most, &rate)| most.max(f64::from(rate))).collect()
            });
            // What a class changes by at a read-out is not known yet: half of the most that it ever does will do.
            let enough = changes.changed().iter().map(|&changed| changed >= ENOUGH);
            let rates: Vec<Option<f64>> =
                most.into_iter().zip(enough).map(|(most, enough)| enough.then_some(most / 2.0)).collect();
            let track = Track::new(signature, &rates, changes.rates().take(FRAMES), None);
            match track {
                Some(track) => {
                    let times = changes.rates().take(FRAMES);
                    let times = times.map(|(frame, rates)| (track.times[frame], rates));
                    (kind, track.start, judge(signature, changes, times))
                }
                None => (kind, 0, Verdict::Against),
            }
        };
        self.only((0..self.kinds.len()).map(verdict))
    }

    /// The one that fits, if all others do not.
    fn only(&self, verdicts: impl Iterator<Item = (usize, usize, Verdict)>) -> Option<Candidate> {
        let mut found = None;
        for (kind, start, verdict) in verdicts {
            match verdict {
                Verdict::Against => {}
                Verdict::For(rates, leak) if found.is_none() && !self.ambiguous[kind] => {
                    let (placement, signature) = self.kinds[kind].clone();
                    found = Some(Candidate { placement, signature, start, rates, leak });
                }
                _ => return None,
            }
        }
        found
    }
}

impl Candidate {
    /// How the schedule goes on through all frames.
    pub fn track(&self, changes: &Changes) -> Option<Track> {
        Track::new(&self.signature, &self.rates, changes.rates(), Some(self.start))
    }
}

/// Judges a candidate by the rates at schedule times.
fn judge<'a>(
    signature: &Signature,
    changes: &Changes,
    rates: impl Iterator<Item = (usize, &'a [f32])>,
) -> Verdict {
    let (classes, span) = (signature.classes, 2 * signature.period);
    // Sums over all periods, two of them side by side.
    let (mut sums, mut counts) = (vec![0.0f64; span * classes], vec![0.0f64; span]);
    for (t, rates) in rates {
        let sums = &mut sums[t % span * classes..][..classes];
        sums.iter_mut().zip(rates).for_each(|(sum, &rate)| *sum += f64::from(rate));
        counts[t % span] += 1.0;
    }
    if counts.contains(&0.0) {
        return Verdict::Open;
    }
    let (mut found, mut leak, mut open) = (vec![None; classes], 0.0f64, false);
    for class in (0..classes).filter(|&class| changes.changed()[class] >= ENOUGH) {
        let mean_rate = |t: usize| sums[t * classes + class] / counts[t];
        let (floor, peak) = (0..span)
            .map(mean_rate)
            .fold((f64::INFINITY, 0.0f64), |(floor, peak), rate| (floor.min(rate), peak.max(rate)));
        if peak - floor < CLEAR * peak {
            continue;
        }
        let rate = |t: usize| mean_rate(t) - floor;
        let (at, between): (Vec<usize>, Vec<usize>) = (0..span).partition(|&t| signature.at(t)[class]);
        let mean = |times: &[usize]| times.iter().map(|&t| rate(t)).sum::<f64>() / times.len().max(1) as f64;
        let read = mean(&at);
        let held = between.iter().map(|&t| rate(t)).fold(0.0, f64::max);
        if held > AGAINST * read {
            return Verdict::Against;
        }
        let even = at.iter().all(|&t| rate(t) >= EVEN * read);
        open |= held > FOR * read || !even;
        leak = leak.max(held / read);
        found[class] = Some(read + floor);
    }
    if open || found.iter().all(Option::is_none) { Verdict::Open } else { Verdict::For(found, leak) }
}

/// Whether pixels of a recording that shows `pattern` from schedule time `start` on are exposed as those of the other one.
pub fn reads_alike(pattern: &Pattern, start: i64, other: &Pattern, other_start: i64) -> bool {
    let [rows, cols] = [pattern.rows().max(other.rows()), pattern.cols().max(other.cols())];
    (0..pattern.period() as i64).all(|t| {
        (0..rows).all(|y| {
            (0..cols).all(|x| {
                let [one, two] = [(pattern, start), (other, other_start)].map(|(pattern, start)| {
                    let readout = pattern.schedule(y, x).covering(start + t);
                    (start + t - readout.start, readout.shutter.frames(), readout.shutter.open().to_vec())
                });
                one == two
            })
        })
    })
}
