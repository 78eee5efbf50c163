//! How long windows are, and as how large tiles frames are computed.

use super::Backend;
use super::pool::with_hop;
use super::settings::Settings;
use super::skip::{Skip, cell_frames};
use super::tiles::{Grid, Limits};
use crate::Result;
use crate::frame::Extent;
use crate::math::lcm;
use crate::network::{Footprint, Graph, Model, NetworkError, Plan};
use crate::sensor::Calibration;

/// Where windows follow each other, long ones save nothing but their own beginnings and ends. So they take about as many
/// bytes at most, but give as many frames at least (docs/performance.md).
const STREAM_BYTES: usize = 1 << 30;
const STREAM_FRAMES: usize = 8;
/// How long windows and their parts are, in frames.
pub struct Lengths {
    /// Result frames of a window, if memory allows.
    pub hop: usize,
    /// Least result frames of a window: `hop`, where that is fixed.
    pub least: usize,
    /// Frames of a cell, at most the window's.
    pub cell: usize,
    /// A window can be shorter by a multiple of this.
    pub step: usize,
    /// Whether all windows are computed, one after the other.
    pub streams: bool,
}

/// A window that may give any number of result frames ([`Graph::stretches`]) is cut into slabs that repeat with the
/// pattern, and some of them can be left out.
pub fn lengths(graph: &Graph, calibration: &Calibration, settings: &Settings) -> Result<Lengths> {
    let hop = graph.window.hop;
    let [granularity, ..] = graph.granularity()?;
    let wanted = settings.hop.unwrap_or(hop);
    if !graph.stretches()? {
        if wanted != hop {
            let problem = format!("its windows give {hop} frames, and cannot give {wanted}");
            return Err(NetworkError::Graph(graph.name.clone(), problem).into());
        }
        return Ok(Lengths { hop, least: hop, cell: hop, step: hop, streams: false });
    }
    let least = |hop: usize, step: usize| if settings.hop.is_some() { hop } else { step };
    if settings.skip == Skip::Off {
        let hop = wanted.next_multiple_of(granularity).max(1);
        return Ok(Lengths {
            hop,
            least: least(hop, granularity),
            cell: hop,
            step: granularity,
            streams: settings.ensemble <= 1,
        });
    }
    let cell = cell_frames(lcm(granularity, calibration.period));
    let hop = wanted.max(1).next_multiple_of(cell);
    Ok(Lengths { hop, least: least(hop, cell), cell, step: cell, streams: false })
}

/// `model` with the windows that [`Synthesizer::new`](super::Synthesizer::new) chooses for frames of `extent` [rows, columns].
pub fn fitted(
    model: &Model,
    calibration: &Calibration,
    extent: impl Into<Extent>,
    backend: &Backend,
) -> Result<Model> {
    let lengths = lengths(&model.graph, calibration, &Settings::default())?;
    Ok(fit(model, calibration, extent.into(), backend.limits(None), &lengths)?.0)
}

/// The window and the tiles with the fewest operations for each result frame within `limits`. Short windows compute
/// more frames that no result keeps, if they do not follow each other, and small tiles more pixels; both save memory, and
/// neither changes a result.
pub fn fit(
    model: &Model,
    calibration: &Calibration,
    extent: Extent,
    limits: Limits,
    lengths: &Lengths,
) -> Result<(Model, Grid)> {
    let candidate = |hop: usize| -> Result<(f64, Model, Grid)> {
        let model = with_hop(model, hop);
        let grid = Grid::fit(&model, calibration, extent.into(), limits)?;
        let [height, width] = grid.tile_extent();
        let flop = grid.count() as f64 * Plan::lower(&model, height, width)?.flop() / hop as f64;
        Ok((flop, model, grid))
    };
    let shorter = |&hop: &usize| {
        let half = (hop / 2).next_multiple_of(lengths.step).max(lengths.least);
        (half < hop).then_some(half)
    };
    let mut best = candidate(lengths.hop);
    for hop in std::iter::successors(Some(lengths.hop), shorter).skip(1) {
        if best.as_ref().is_ok_and(|(_, _, grid)| grid.count() == 1) {
            break;
        }
        best = match (best, candidate(hop)) {
            (Ok(before), Ok(now)) => Ok(if now.0 < before.0 { now } else { before }),
            (Ok(one), Err(_)) | (Err(_), Ok(one)) => Ok(one),
            (Err(error), Err(_)) => Err(error),
        };
    }
    let (_, mut model, mut grid) = best?;
    while lengths.streams && grid.count() == 1 {
        let Footprint { slots, state } = limits.footprint(&model, grid.extent(), true)?;
        let Some(state) = state else { break };
        let before = model.graph.window.hop;
        let hop = (before / 2).next_multiple_of(lengths.step).max(lengths.least).max(STREAM_FRAMES);
        if hop >= before || 4 * (slots.iter().sum::<usize>() + state) <= STREAM_BYTES {
            break;
        }
        (_, model, grid) = candidate(hop)?;
    }
    Ok((model, grid))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::presets;
    use crate::sensor::{Form, Pattern, Response};

    fn tiny() -> (Model, Calibration) {
        let model = Model::random(presets::by_name("tiny").unwrap().graph().unwrap(), 0).unwrap();
        let pattern = Pattern::built_in("mpve-1-4").unwrap();
        let response = Response::new(Form::Linear, pattern.shortest_exposure() as f64).unwrap();
        (model, Calibration::new(&pattern, &response))
    }

    #[test]
    fn windows_that_follow_each_other_take_a_gibibyte_or_eight_frames() {
        let (model, calibration) = tiny();
        let hop = |extent: [usize; 2], settings: &Settings| {
            let lengths = lengths(&model.graph, &calibration, settings).unwrap();
            let limits = Limits { buffer: u64::MAX, total: u64::MAX, piece: Some(2 << 20), side: None };
            let (model, _) = fit(&model, &calibration, extent.into(), limits, &lengths).unwrap();
            model.graph.window.hop
        };
        assert_eq!(hop([128, 128], &Settings::default()), model.graph.window.hop);
        let (large, huge) = ([720, 1280], [2160, 3840]);
        let between = hop(large, &Settings::default());
        assert!(between < model.graph.window.hop && between > STREAM_FRAMES, "{between}");
        assert_eq!(hop(huge, &Settings::default()), STREAM_FRAMES);
        // Boxes of cells do not follow each other, and what the user says holds.
        assert_eq!(hop(huge, &Settings { skip: Skip::Exact, ..Settings::default() }), model.graph.window.hop);
        assert_eq!(hop(huge, &Settings { hop: Some(40), ..Settings::default() }), 40);
    }

    #[test]
    fn windows_are_as_long_as_memory_allows() {
        let (model, calibration) = tiny();
        let lengths = lengths(&model.graph, &calibration, &Settings::default()).unwrap();
        let extent = Extent::from([128, 128]);
        let bytes = |hop: usize| {
            let model = with_hop(&model, hop);
            let Footprint { slots, state } = Plan::footprint(&model, 128, 128, usize::MAX, true).unwrap();
            4 * (slots.iter().sum::<usize>() + state.unwrap()) as u64
        };
        let fitted = |total: u64, lengths: &Lengths| {
            let limits = Limits { buffer: u64::MAX, total, piece: None, side: None };
            let (model, grid) = fit(&model, &calibration, extent, limits, lengths).unwrap();
            (model.graph.window.hop, grid.count())
        };
        assert_eq!(fitted(bytes(48), &lengths), (48, 1));
        // A shorter window costs less than the halos of tiles.
        assert_eq!(fitted(bytes(48) - 1, &lengths), (24, 1));
        // With a hop that is fixed there are only tiles.
        let (hop, tiles) = fitted(bytes(48) - 1, &Lengths { least: 48, ..lengths });
        assert!(hop == 48 && tiles > 1);
        // The smallest windows need tiles too.
        let (_, tiles) = fitted(bytes(1) / 2, &lengths);
        assert!(tiles > 1);
    }
}
