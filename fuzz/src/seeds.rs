//! Sound files to begin with.

use std::path::Path;

use pix2hdr::sensor::{Capture, Form, Pattern, Sampler, Timing};
use pix2hdr::video::{self, Video, Writing};

use crate::Reader;

/// A small capture, sample and hold.
pub fn capture() -> Capture {
    let pattern = Pattern::built_in("mpve-1-4").expect("a built-in pattern");
    let mut sampler = Sampler::new(pattern, Form::Linear).expect("a camera");
    (sampler.timing, sampler.schedule_start) = (Timing::Hold, 3);
    sampler.sample(&ramp(11, 6, 8)).expect("a capture")
}

/// A video that rises from pixel to pixel.
pub fn ramp(frames: usize, height: usize, width: usize) -> Video {
    let pixel = |i: usize| (i % 97) as f32 / 90.0;
    Video::new(frames, height, width, (0..frames * height * width).map(pixel).collect()).expect("a video")
}

/// Files that `reader` can read, or nearly. Long because it is data: the files of one reader after the other.
pub fn of(reader: Reader) -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().expect("a folder");
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the repository");
    let files_in = |folder: &str, extension: &str, largest: u64| -> Vec<Vec<u8>> {
        let entries = std::fs::read_dir(root.join(folder)).expect("the repository is whole").flatten();
        let mut paths: Vec<_> = entries
            .filter(|entry| entry.metadata().is_ok_and(|meta| meta.len() <= largest))
            .map(|entry| entry.path())
            .filter(|path| path.extension().is_some_and(|found| found == extension))
            .collect();
        paths.sort();
        paths.into_iter().map(|path| std::fs::read(path).expect("a file")).collect()
    };
    let texts = |texts: &[&str]| texts.iter().map(|text| text.as_bytes().to_vec()).collect::<Vec<_>>();
    let written = |name: &str, video: &Video, half: bool| {
        let path = folder.path().join(name);
        video::write(&path, video, Writing { half, ..Writing::default() }).expect("it is written");
        std::fs::read(path).expect("a file")
    };
    match reader {
        Reader::CaptureJson => {
            let [_, json] = capture().write(folder.path()).expect("it is written");
            let mut seeds = vec![std::fs::read(json).expect("a file")];
            seeds.extend(texts(&[
                r#"{"pattern": {"tile": [[[2, 1], {"exposure": 4, "phase": 2}], [{"period": 10, "shutters": [{"start": 1, "frames": 3, "open": [0, 2]}, {"start": 4, "frames": 7}]}, [8, 4]]]}, "timing": "covering", "schedule_start": -7, "bit_depth": 12, "black_level": 64.5, "white_level": 4000, "frame_period_ms": 0.5, "response": {"table": [[0, 0], [0.25, 0.5], [1, 1]]}, "full_well_e": 9000, "read_noise_e": 2.67, "anchor": 3.5}"#,
                r#"{"pattern": "mpve-1-4", "bit_depth": 10, "white_level": 1023, "dead_pixels": [[0, 0], [5, 7], [2, 3]], "missing_count": 512}"#,
                r#"{"pattern": "coded", "bit_depth": 10, "white_level": 1023, "response": {"gamma": 2.2}}"#,
                r#"{"pattern": "interleaved", "timing": "hold", "bit_depth": 8, "white_level": 255, "response": {"soft-knee": 0.6}}"#,
                r#"{"pattern": "mpve-1-16", "bit_depth": 8, "white_level": 255, "response": "response.csv"}"#,
            ]));
            seeds
        }
        Reader::CaptureArray => {
            let [array, _] = capture().write(folder.path()).expect("it is written");
            let whole = std::fs::read(array).expect("a file");
            let text = String::from_utf8_lossy(&whole[..128]).replace("False", "True ");
            let fortran = [&whole[..10], &text.as_bytes()[text.len() - 118..], &whole[128..]].concat();
            let bytes = [
                &b"\x93NUMPY\x01\x00\x46\x00"[..],
                b"{'descr': '|u1', 'fortran_order': False, 'shape': (2, 4, 8), }        \n",
                &[7; 64],
            ]
            .concat();
            vec![whole, fortran, bytes]
        }
        Reader::Npy => vec![
            written("a.npy", &ramp(3, 4, 5), true),
            written("b.npy", &ramp(1, 7, 3), false),
            [
                &b"\x93NUMPY\x02\x00\x46\x00\x00\x00"[..],
                b"{'descr': '<f8', 'fortran_order': True, 'shape': (2, 2), }           \n",
                &[0; 32],
            ]
            .concat(),
        ],
        Reader::Exr => {
            let mut seeds =
                vec![written("a.exr", &ramp(1, 9, 21), true), written("b.exr", &ramp(1, 40, 5), false)];
            seeds.extend(pictures());
            seeds
        }
        Reader::Radiance => {
            let head = "#?RADIANCE\n# by hand\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=2.0\n\n";
            let mut runs = format!("{head}-Y 2 +X 10\n").into_bytes();
            for _ in 0..2 {
                runs.extend([2, 2, 0, 10]);
                runs.extend([138, 128, 138, 100, 10, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 138, 129]);
            }
            let flat = [format!("{head}+X 3 -Y 2\n").as_bytes(), &[128, 100, 90, 129].repeat(6)].concat();
            let old = [
                "#?RGBE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 263\n".as_bytes(),
                &[1, 2, 3, 129, 1, 1, 1, 3, 9, 9, 9, 130, 1, 1, 1, 2, 1, 1, 1, 1],
            ]
            .concat();
            vec![runs, flat, old]
        }
        Reader::Weights => files_in("weights-format/golden", "safetensors", 6000),
        Reader::Graph => {
            let mut seeds = files_in("weights-format/presets", "json", u64::MAX);
            seeds.extend(texts(&[
                r#"{"version": 1, "name": "t", "pattern": "any", "window": {"frames": 3, "lead": 1, "hop": 1}, "nodes": [
                {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
                {"name": "logs", "op": "log_irradiance", "inputs": ["measurement"]},
                {"name": "f", "op": "features", "inputs": ["measurement", "estimate", "logs"], "channels": ["log_estimate", "saturated"], "neighbours": [-1, 1], "block": [1, 2, 2]},
                {"name": "a", "op": "conv3d", "inputs": ["f"], "out_channels": 4, "kernel": [3, 3, 3], "stride": [1, 2, 2], "activation": {"leaky_relu": 0.2}, "norm": true},
                {"name": "b", "op": "conv_transpose3d", "inputs": ["a"], "out_channels": 4, "kernel": [1, 4, 4], "stride": [1, 2, 2], "activation": "sigmoid"},
                {"name": "all", "op": "concat", "inputs": ["b", "f"]},
                {"name": "w", "op": "conv3d", "inputs": ["all"], "out_channels": 12, "kernel": [1, 1, 1], "stride": [1, 1, 1], "activation": "none"},
                {"name": "result", "op": "blend", "inputs": ["w", "logs", "estimate"], "block": [1, 2, 2], "taps": [[0, -1, 0], [1, 0, 1]]}], "output": "result"}"#,
                r#"{"version": 1, "name": "t", "pattern": "mpve-1-4", "window": {"frames": 2, "lead": 0, "hop": 2}, "nodes": [
                {"name": "estimate", "op": "box_estimate", "inputs": ["measurement"]},
                {"name": "f", "op": "features", "inputs": ["measurement", "estimate"], "channels": ["measurement", "log_irradiance", "log_exposure"], "block": [1, 1, 1]},
                {"name": "ldr", "op": "conv3d", "inputs": ["f"], "out_channels": 2, "kernel": [1, 3, 3], "stride": [1, 1, 1], "activation": "sigmoid"},
                {"name": "i", "op": "inverse_response", "inputs": ["ldr"], "exposures": [2, 8]},
                {"name": "w", "op": "conv3d", "inputs": ["i"], "out_channels": 2, "kernel": [1, 1, 1], "stride": [1, 1, 1], "activation": {"softplus": 0.001}, "add": "ldr"},
                {"name": "result", "op": "fuse", "inputs": ["w", "i"]}], "output": "result"}"#,
            ]));
            seeds
        }
        Reader::Pattern => texts(&[
            r#"{"name": "p", "tile": [[[2, 1], [4, 2], [8, 0]], [[8, 4], {"exposure": 2, "phase": 1}, [4, 0]]]}"#,
            r#"{"tile": [[{"period": 10, "shutters": [{"start": 0, "frames": 3}, {"start": 3, "frames": 7, "open": [0, 2, 5]}]}, {"period": 5, "shutters": [{"start": 4, "frames": 5}]}]]}"#,
        ]),
        Reader::Response => texts(&[
            "x,y\n0,10\n1,40\n2.5,60\n8,250\n",
            "# measured\n0;0\n0.1;0.1\n1e3;1\n",
            "0\t0\n1\t1e-300\n2\t1\n",
        ]),
        Reader::Camera => texts(&[
            r#"{"full_well_e": 200, "read_noise_e": 2.67, "black_level": 48, "bit_depth": 10, "frame_period_ms": 1, "response": "linear"}"#,
            r#"{"full_well_e": null, "bit_depth": 16, "response": {"table": [[0, 0], [0.25, 0.5], [1, 1]]}}"#,
        ]),
        Reader::DeadPixels => texts(&["row,column\n0,0\n5,7\n", "# hot\n2 3\n\n4\t1\n"]),
    }
}

/// Pictures in every compression, in lines and in tiles, as other programs write them.
fn pictures() -> Vec<Vec<u8>> {
    use exr::image::{Blocks, Encoding, Image, Layer, SpecificChannels};
    use exr::meta::attribute::{Compression, LineOrder};
    use exr::prelude::{LayerAttributes, Vec2, WritableImage, f16};

    let compressions = [
        Compression::Uncompressed,
        Compression::RLE,
        Compression::ZIP1,
        Compression::PIZ,
        Compression::PXR24,
        Compression::B44,
    ];
    let kinds =
        compressions.into_iter().zip([Blocks::ScanLines, Blocks::Tiles(Vec2(16, 8))].into_iter().cycle());
    let picture = |(compression, blocks): (Compression, Blocks)| {
        let channels = SpecificChannels::rgb(|Vec2(x, y): Vec2<usize>| {
            (x as f32 / 8.0, f16::from_f32(0.5 + y as f32), 2_u32)
        });
        let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
        let mut bytes = std::io::Cursor::new(Vec::new());
        let layer = Layer::new((19, 11), LayerAttributes::default(), encoding, channels);
        Image::from_layer(layer).write().to_buffered(&mut bytes).expect("it is written");
        bytes.into_inner()
    };
    kinds.map(picture).collect()
}
