//! Run time against error, as a picture.

use std::collections::{BTreeMap, BTreeSet};

use super::Row;
use crate::quality::Plot;

/// Plots PSNR-µ over the time per frame, one line for each way to compute; rows of several scenes are averaged, and
/// rows without a PSNR-µ left out. The box filter is a level line.
pub fn frontier(rows: &[Row]) -> Plot {
    /// Sums over scenes: milliseconds, dB, rows.
    type Sum = (f64, f64, f64);
    let mut series: BTreeMap<String, BTreeMap<String, Sum>> = BTreeMap::new();
    let sizes: BTreeSet<_> = rows.iter().map(|row| (row.width, row.height)).collect();
    for row in rows {
        let Some(psnr) = row.psnr_mu_db else { continue };
        let mut name = format!("{} {}", row.executor, row.precision);
        if row.skip != "off" {
            name += &format!(", skip {}", row.skip);
        }
        if sizes.len() > 1 {
            name += &format!(", {}×{}", row.width, row.height);
        }
        let sum = series.entry(name).or_default().entry(row.net()).or_default();
        *sum = (sum.0 + row.ms_per_frame_median, sum.1 + psnr, sum.2 + 1.0);
    }
    let mut plot =
        Plot::new("run time against error", "inference, ms per frame", "PSNR-µ / dB").logarithmic_x();
    let mut ends = (f64::INFINITY, 0.0_f64);
    for (name, nets) in series {
        let mut points: Vec<(String, (f64, f64))> =
            nets.into_iter().map(|(net, (ms, db, n))| (net, (ms / n, db / n))).collect();
        points.sort_by(|a, b| a.1.0.total_cmp(&b.1.0));
        for (_, (ms, _)) in &points {
            ends = (ends.0.min(*ms), ends.1.max(*ms));
        }
        plot = plot.marked_series(name, points);
    }
    // The box filter on the same rows; an empty plot still shows where it lies.
    let shown: Vec<&Row> = rows.iter().filter(|row| row.psnr_mu_db.is_some()).collect();
    let shown = if shown.is_empty() { rows.iter().collect() } else { shown };
    let level = shown.iter().map(|row| row.box_psnr_mu_db).sum::<f64>() / shown.len() as f64;
    let (left, right) = match ends {
        (left, right) if left < right => (left, right),
        (left, right) if left == right => (left / 1.5, right * 1.5),
        _ => (1.0, 10.0),
    };
    plot.series("box filter", [(left, level), (right, level)])
}
