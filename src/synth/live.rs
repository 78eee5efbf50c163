//! What all live sources share: short windows, and which frames are dropped when synthesis falls behind.

use crate::Result;
use crate::network::{Graph, Window};

/// Result frames of a window, where the user says nothing and the net can do with fewer than its own number: a picture is
/// there sooner, and requests take effect sooner, for half as much computation again.
const HOP: usize = 32;

/// Makes the windows of `graph` as short as a live source wants them, if the net gives the same frames for any.
pub fn shorten(graph: &mut Graph) -> Result<()> {
    let Window { frames, lead, hop } = graph.window;
    if hop > HOP && graph.stretches()? {
        graph.window = Window { frames: frames - hop + HOP, lead, hop: HOP };
    }
    Ok(())
}

/// When a live source that delivers its frames in blocks drops some of them. What is synthesised in one go is a run, a
/// recording of its own: it ends where frames are dropped, so no window mixes those from before and after.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DropPolicy {
    /// Frames that are exposed before they are delivered together; a multiple of the pattern's period.
    pub block: usize,
}

impl DropPolicy {
    /// Frames that are exposed when a run begins, so that a window can be computed at once.
    pub const fn head_start(self) -> usize {
        2 * self.block
    }

    /// Frames that are kept when `rate` of them are exposed per second, before the oldest are dropped: what a run begins
    /// with, as many again, and a quarter of a second.
    pub fn kept(self, rate: f64) -> f64 {
        2.0 * self.head_start() as f64 + 0.25 * rate
    }

    /// Whether a run ends because the block of which frame `end` is behind the last was delivered too late to be taken,
    /// when `exposed` frames are exposed.
    pub fn is_too_late(self, end: usize, exposed: f64, rate: f64) -> bool {
        exposed > end as f64 + self.kept(rate)
    }
}

/// Follows which frames of a live source are delivered and which dropped.
#[derive(Clone, Copy, Debug)]
pub struct Backlog {
    policy: DropPolicy,
    /// The first frame that is neither delivered nor dropped.
    due: usize,
}

impl Backlog {
    /// Of a source that has delivered nothing.
    pub fn new(policy: DropPolicy) -> Self {
        Self { policy, due: 0 }
    }

    /// Begins a run with the newest blocks, when `exposed` frames are exposed: its first frame, and how many frames before
    /// it are dropped.
    pub fn begin(&mut self, exposed: f64) -> (usize, usize) {
        let Self { policy, due } = *self;
        let newest = (exposed.max(0.0) as usize).saturating_sub(policy.head_start());
        self.due = (newest / policy.block * policy.block).max(due);
        (self.due, self.due - due)
    }

    /// Ends the run, which has delivered `delivered` frames: how many are dropped, of a block that was begun.
    pub fn end(&mut self, delivered: usize) -> usize {
        let done = self.due + delivered;
        self.due = done.next_multiple_of(self.policy.block);
        self.due - done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::presets;

    const POLICY: DropPolicy = DropPolicy { block: 32 };

    #[test]
    fn frames_are_delivered_or_dropped_once() {
        let mut backlog = Backlog::new(POLICY);
        assert_eq!(backlog.begin(64.0), (0, 0));
        assert_eq!(backlog.end(70), 26);
        // Synthesis keeps up: the next run goes on where this one ended.
        assert_eq!(backlog.begin(100.0), (96, 0));
        assert_eq!(backlog.end(0), 0);
        assert_eq!(backlog.begin(1000.9), (928, 832));
        assert_eq!(backlog.end(32), 0);
        assert_eq!(backlog.begin(-1.0), (960, 0));
    }

    #[test]
    fn a_run_ends_when_more_waits_than_is_kept() {
        let end = 320;
        assert!(!POLICY.is_too_late(end, 320.0 + 128.0 + 250.0, 1000.0));
        assert!(POLICY.is_too_late(end, 320.0 + 128.0 + 250.1, 1000.0));
    }

    #[test]
    fn windows_are_shortened_where_that_changes_nothing() {
        let mut fast = presets::by_name("fast").unwrap().graph().unwrap();
        let before = fast.window;
        assert!(before.hop > HOP);
        shorten(&mut fast).unwrap();
        let Window { frames, lead, hop } = fast.window;
        assert_eq!((lead, hop, before.frames - frames), (before.lead, HOP, before.hop - HOP));
        // Without the frames around, results depend on where the window ends.
        fast.window = Window { frames: before.hop, lead: 0, ..before };
        let tight = fast.window;
        shorten(&mut fast).unwrap();
        assert_eq!(fast.window, tight);
    }
}
