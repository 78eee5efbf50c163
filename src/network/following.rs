//! What a window has to compute that follows another one.
//!
//! Where frames do not depend on their window, two windows in a row share all frames of each tensor but the last few. So
//! most of a window is known, and of that only what later frames are computed from has to be kept.

use std::collections::{BTreeMap, HashMap};
use std::ops::Range;

use super::error::NetworkError;
use super::graph::{FRAMES, Graph, MEASUREMENT};
use super::pieces::Group;

/// The frames that a window has to do with which follows another one.
pub(super) struct FollowingFrames<'a> {
    /// Frames of each tensor that are computed: the last ones of those that a window by itself computes.
    pub computed: HashMap<&'a str, Range<usize>>,
    /// How many frames before those are read, where there are any.
    pub carried: BTreeMap<&'a str, usize>,
}

/// What is new in a window behind another one, where each window computes the frames `needed`. `None` where frames depend
/// on their window: where a layer reads its padding in time, or goes through time in steps or from its beginning.
pub(super) fn following_frames<'a>(
    graph: &'a Graph,
    needed: &HashMap<&'a str, Range<usize>>,
    groups: &[Group<'_>],
) -> Result<Option<FollowingFrames<'a>>, NetworkError> {
    let hop = graph.window.hop;
    if graph.granularity()?[0] != 1 || needed.values().any(|frames| frames.len() < hop) {
        return Ok(None);
    }
    let computed: HashMap<&str, Range<usize>> =
        needed.iter().map(|(&name, frames)| (name, frames.end - hop..frames.end)).collect();
    let mut carried: BTreeMap<&str, usize> = BTreeMap::new();
    for node in graph.nodes.iter().filter(|node| computed.contains_key(node.name.as_str())) {
        if !node.relation()[FRAMES].begins_anywhere() {
            return Ok(None);
        }
        for (name, read) in node.reads(FRAMES, computed[node.name.as_str()].clone()) {
            let Range { start, end } = &needed[name];
            if read.start < *start as isize || read.end > *end as isize {
                return Ok(None);
            }
            let before = computed[name].start.saturating_sub(read.start as usize);
            // All of the measurement is given anew.
            if before > 0 && name != MEASUREMENT {
                let known = carried.entry(name).or_default();
                *known = before.max(*known);
            }
        }
    }
    let lost = groups.iter().flat_map(|group| &group.inner).any(|name| carried.contains_key(name));
    Ok((!lost).then_some(FollowingFrames { computed, carried }))
}
