use std::fs;

use super::super::format::{ReadCounts, WriteCounts, WriteVideo};
use super::super::{Counts, Video};
use super::header::MAGIC;
use super::video::NpyWriter;
use super::*;
use crate::frame::Plane;

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn ramp() -> Video {
    Video::new(3, 4, 5, (0..60).map(|i| i as f32 / 8.0).collect()).unwrap()
}

/// A file with the header `text` and `data_len` bytes of zeros.
fn file(folder: &tempfile::TempDir, text: &str, data_len: usize) -> std::path::PathBuf {
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.extend(vec![0; data_len]);
    let path = folder.path().join("x.npy");
    fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn videos_round_trip() {
    let folder = folder();
    let path = folder.path().join("v.npy");
    for half in [false, true] {
        write_video(&path, &ramp(), half).unwrap();
        assert_eq!(read_video(&path).unwrap(), ramp());
    }
    assert_eq!(fs::metadata(&path).unwrap().len() % 64, 120 % 64);
}

#[test]
fn half_clamps_instead_of_overflowing() {
    let folder = folder();
    let path = folder.path().join("v.npy");
    write_video(&path, &Video::new(1, 1, 2, vec![1e9, 1e-9]).unwrap(), true).unwrap();
    assert_eq!(read_video(&path).unwrap().data, [65504.0, 0.0]);
}

#[test]
fn counts_round_trip() {
    let folder = folder();
    let path = folder.path().join("c.npy");
    let bytes = Counts::U8((0..24).collect());
    write_counts(&path, &[2, 3, 4], &bytes).unwrap();
    assert_eq!(read_counts(&path).unwrap(), ([2, 3, 4], bytes.clone()));
    let words = Counts::U16((0..24).map(|i| i * 2000).collect());
    write_counts(&path, &[2, 3, 4], &words).unwrap();
    assert_eq!(read_counts(&path).unwrap(), ([2, 3, 4], words));
    assert!(write_counts(&path, &[2, 3, 5], &bytes).is_err());
    assert!(read_video(&path).unwrap_err().to_string().contains("integers"));
}

/// Frame by frame, a file is what it is as a whole, and only what was promised can be written.
#[test]
fn counts_are_read_and_written_frame_by_frame() {
    let folder = folder();
    let [whole, path] = ["whole.npy", "c.npy"].map(|name| folder.path().join(name));
    for counts in [Counts::U8((0..24).collect()), Counts::U16((0..24).map(|i| i * 2000).collect())] {
        write_counts(&whole, &[2, 3, 4], &counts).unwrap();
        let mut reader = CountsReader::open(&whole).unwrap();
        assert_eq!((reader.extents(), reader.bits()), ([2, 3, 4], counts.bits()));
        let mut writer = CountsWriter::begin(&path, [2, 3, 4], counts.bits()).unwrap();
        for t in 0..2 {
            writer.push(&reader.frame(t).unwrap()).unwrap();
        }
        for t in [1, 0] {
            assert_eq!(reader.frame(t).unwrap(), counts.range(12 * t..12 * (t + 1)));
        }
        assert!(writer.push(&counts.range(0..12)).is_err());
        Box::new(writer).finish().unwrap();
        assert!(fs::read(&path).unwrap() == fs::read(&whole).unwrap());
    }
    let mut writer = CountsWriter::begin(&path, [2, 3, 4], 8).unwrap();
    for wrong in [Counts::U16(vec![0; 12]), Counts::U8(vec![0; 11])] {
        assert!(writer.push(&wrong).unwrap_err().to_string().contains("c.npy"));
    }
    writer.push(&Counts::U8(vec![0; 12])).unwrap();
    assert!(Box::new(writer).finish().unwrap_err().to_string().contains("1 of 2"));
}

#[test]
fn one_frame_double_and_fortran_order_are_read() {
    let folder = folder();
    let text = "{'descr': '<f8', 'fortran_order': True, 'shape': (2, 3), }\n";
    let path = file(&folder, text, 0);
    let mut bytes = fs::read(&path).unwrap();
    // Columns one behind the other: (0, 0), (1, 0), (0, 1), …
    bytes.extend([0.0_f64, 3.0, 1.0, 4.0, 2.0, 5.0].iter().flat_map(|v| v.to_le_bytes()));
    fs::write(&path, bytes).unwrap();
    let video = read_video(&path).unwrap();
    assert_eq!(video, Video::new(1, 2, 3, (0..6).map(|i| i as f32).collect()).unwrap());
}

/// Frames of an array in Fortran order are those of the same array in C order, in whatever order they are read; the whole
/// does not fit into a block.
#[test]
fn fortran_order_is_read_frame_by_frame() {
    let folder = folder();
    let (frames, height, width) = (11, 3, 5);
    let text =
        format!("{{'descr': '<u2', 'fortran_order': True, 'shape': ({frames}, {height}, {width}), }}\n");
    let path = file(&folder, &text, 0);
    let mut bytes = fs::read(&path).unwrap();
    let value = |t: usize, y: usize, x: usize| (100 * t + 10 * y + x) as u16;
    let places = (0..width).flat_map(|x| (0..height).flat_map(move |y| (0..frames).map(move |t| (t, y, x))));
    bytes.extend(places.flat_map(|(t, y, x)| value(t, y, x).to_le_bytes()));
    fs::write(&path, bytes).unwrap();
    let frame = |t: usize| -> Vec<u16> {
        (0..height).flat_map(|y| (0..width).map(move |x| value(t, y, x))).collect()
    };
    let mut reader = CountsReader::open(&path).unwrap();
    for t in (0..frames).chain([3, 10, 0, 9, 1]) {
        assert_eq!(reader.frame(t).unwrap(), Counts::U16(frame(t)), "frame {t}");
    }
    let whole = Counts::U16((0..frames).flat_map(frame).collect());
    assert_eq!(read_counts(&path).unwrap(), ([frames, height, width], whole));
}

#[test]
fn every_truncation_is_refused() {
    let folder = folder();
    let path = folder.path().join("v.npy");
    write_video(&path, &ramp(), false).unwrap();
    let whole = fs::read(&path).unwrap();
    for length in 0..whole.len() {
        fs::write(&path, &whole[..length]).unwrap();
        let error = read_video(&path).unwrap_err().to_string();
        assert!(error.contains("v.npy"), "{error}");
    }
    fs::write(&path, [&whole[..], &[0]].concat()).unwrap();
    assert!(read_video(&path).is_err());
}

#[test]
fn wrong_headers_are_refused_with_the_cause() {
    let folder = folder();
    let fail = |text: &str, data_len| {
        let path = file(&folder, text, data_len);
        let (video, counts) = (read_video(&path).unwrap_err(), read_counts(&path).unwrap_err());
        format!("{video} | {counts}")
    };
    let shape = |shape: &str| format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}");
    assert!(fail(&shape("(4,)"), 16).contains("has shape [4]"));
    assert!(fail(&shape("()"), 4).contains("has shape []"));
    assert!(fail(&shape("(1, 1, 2, 2)"), 16).contains("has shape [1, 1, 2, 2]"));
    assert!(fail(&shape("(0, 4, 4)"), 0).contains("empty"));
    assert!(fail(&shape("(2, 4, 4)"), 64).contains("truncated"));
    assert!(fail(&shape("(0, 4, 4)"), 64).contains("behind them 64 bytes hold something else"));
    assert!(fail(&shape("(np.int64(1), 4, 4)"), 64).contains("a size expected at \"np.int64"));
    // Sizes whose product overflows, or wraps to the right length.
    assert!(fail(&shape("(4294967296, 4294967296, 1)"), 0).contains("promises"));
    assert!(fail(&shape("(18446744073709551615, 2, 3)"), 8).contains("promises"));
    assert!(fail(&shape("(99999999999999999999999, 2, 3)"), 8).contains("size"));
    assert!(fail(&shape("(100000, 100000, 100)"), 64).contains("promises"));
    assert!(fail(&shape("(-1, 2, 3)"), 8).contains("size"));
    assert!(fail(&shape(&"(".repeat(9000)), 8).contains("size"));
    assert!(fail(&shape(&format!("({})", "1,".repeat(3000))), 4).contains("axes"));
    let descr = |descr: &str| format!("{{'descr': {descr}, 'fortran_order': False, 'shape': (1, 1, 1)}}");
    assert!(fail(&descr("'<i8'"), 8).contains("'<i8'"));
    assert!(fail(&descr("'|O'"), 8).contains("'|O'"));
    assert!(fail(&descr("'>f4'"), 4).contains("big-endian"));
    for (type_of, called) in [
        ("<i2", "signed integers"),
        (">i2", "signed integers"),
        ("<u4", "more than 16 bits"),
        ("|b1", "truth values"),
        ("<c8", "complex numbers"),
        ("<M8[ns]", "no numbers"),
    ] {
        let error = fail(&descr(&format!("'{type_of}'")), 4);
        assert!(error.contains(called) && error.contains("a capture is u8 or u16, a video f16"), "{error}");
    }
    assert!(fail(&descr("[('a', '<f4')]"), 4).contains("records"));
    assert!(fail(&descr("(2, 'x')"), 4).contains("quoted word"));
    assert!(fail("{'descr': '<f4', 'shape': (1, 1, 1)}", 4).contains("without"));
    assert!(fail("{'pickle': 1}", 4).contains("unknown key"));
    assert!(fail("", 4).contains("unreadable"));
    assert!(fail("\u{fe}\u{ff}{", 4).contains("unreadable"));
}

#[test]
fn unusable_pixels_are_named() {
    let folder = folder();
    let path = folder.path().join("v.npy");
    write_video(&path, &ramp(), false).unwrap();
    let whole = fs::read(&path).unwrap();
    for value in [f32::NAN, f32::INFINITY, -1.0] {
        let mut bytes = whole.clone();
        let at = bytes.len() - 60 * 4 + ((2 * 4 + 3) * 5 + 1) * 4;
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        fs::write(&path, bytes).unwrap();
        let error = read_video(&path).unwrap_err().to_string();
        assert!(error.contains("frame 2, row 3, column 1"), "{error}");
    }
    let mut video = ramp();
    video.data[7] = f32::NAN;
    assert!(write_video(&path, &video, false).unwrap_err().to_string().contains("row 1, column 2"));
}

#[test]
fn a_writer_wants_the_promised_frames() {
    let folder = folder();
    let path = folder.path().join("v.npy");
    let mut writer = NpyWriter::begin(&path, [2, 2, 2], false).unwrap();
    assert!(writer.push(Plane::new([1, 3], &[0.0; 3])).is_err());
    writer.push(Plane::new([2, 2], &[0.0; 4])).unwrap();
    assert!(Box::new(writer).finish().unwrap_err().to_string().contains("1 of 2"));
    assert!(fs::read_dir(folder.path()).unwrap().next().is_none());
    let mut writer = NpyWriter::begin(&path, [1, 2, 2], false).unwrap();
    writer.push(Plane::new([2, 2], &[0.0; 4])).unwrap();
    assert!(writer.push(Plane::new([2, 2], &[0.0; 4])).is_err());
    Box::new(writer).finish().unwrap();
    assert!(NpyWriter::begin(&path, [1, 0, 2], false).is_err());
}

/// What other programs write is named, with what to do.
#[test]
fn files_of_other_formats_are_named() {
    let folder = folder();
    let path = folder.path().join("v.npy");
    let fail = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        read_counts(&path).unwrap_err().to_string()
    };
    for (start, word) in [
        (&b"PK\x03\x04\x14\0\0\0"[..], "archive of arrays (.npz)"),
        (b"\0\0\0\x20ftypisom", "a video"),
        (b"RIFF\0\0\0\0AVI ", "a video"),
        (b"\x1aE\xdf\xa3\0\0\0\0", "a video"),
        (b"II*\0\0\0\0\0", "a TIFF"),
        (b"MM\0*\0\0\0\0", "a TIFF"),
        (b"\x89HDF\r\n\x1a\n", "HDF5"),
    ] {
        let error = fail(start);
        assert!(error.contains(word) && error.contains("np.save"), "{error}");
    }
    assert!(fail(b"something").ends_with("is not a NumPy file"));
    write_counts(&path, &[2, 1, 1], &Counts::U8(vec![1, 2])).unwrap();
    let twice = fs::read(&path).unwrap().repeat(2);
    assert!(fail(&twice).contains("130 bytes hold another array"), "{}", fail(&twice));
}
