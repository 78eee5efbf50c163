//! Pictures on the GPU against their twin.

#[path = "../../tests/support/offscreen.rs"]
mod offscreen;

use super::*;
use crate::frame::Computed;
use crate::tone::Display;
use eframe::egui::{pos2, vec2};
use pix2hdr::gpu::{AdapterChoice, Gpu};
use pix2hdr::network::{Model, Precision};
use pix2hdr::sensor::{Capture, Form, Pattern, Sampler};
use pix2hdr::synth::{Active, Backend, Settings, Synthesizer};
use pix2hdr::video::Video;

fn gpu() -> Gpu {
    Gpu::open(&AdapterChoice { substring: None, allow_software: true }).unwrap().shared()
}

/// R, G and B of a part as a pane of its size shows it.
fn drawn(screen: &mut Screen, queue: &wgpu::Queue, shown: &Shown) -> Vec<u8> {
    let [rows, cols] = shown.part.extent();
    let rect = Rect::from_min_size(pos2(0.0, 0.0), vec2(cols as f32, rows as f32));
    let painting = Painting { pane: 0, shown: Some(shown.clone()), rect, around: rect, sharp: true };
    let size = [cols as u32, rows as u32];
    let descriptor = ScreenDescriptor { size_in_pixels: size, pixels_per_point: 1.0 };
    let device = screen.device.clone();
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    screen.prepare(&painting, queue, &descriptor, &mut encoder);
    offscreen::pixels((&device, queue), TextureFormat::Rgba8Unorm, size, encoder, Vec::new(), |pass| {
        screen.paint(&painting, size, pass);
    })
}

fn frame(height: usize, width: usize) -> Frame {
    let plane = |seed: usize| {
        // Twenty stops, and a few values that no plane should have.
        let value = |i: usize| match i * 7 + seed {
            0..8 => [f32::NAN, f32::INFINITY, -1.0, 0.0, f32::MIN_POSITIVE, 1.0, 3.0, 1e9][i % 8],
            n => ((n * 7919 % 1000) as f32 / 50.0 - 18.0).exp2(),
        };
        Some((0..height * width).map(value).collect())
    };
    let raw = (0..height * width).map(|i| (i * 7919 % 1024) as f32 / 1023.0).collect();
    let active = Active::new([1, height.div_ceil(4), width.div_ceil(4)], |i| i.is_multiple_of(3));
    Frame {
        number: 0,
        height,
        width,
        mosaic: Some(raw),
        filtered: plane(1),
        ours: plane(0),
        truth: plane(2),
        computed: Some(Computed { active: Arc::new(active), slab: 0, cell: [4, 4] }),
        ..Frame::default()
    }
}

/// Values that differ, and the largest difference.
fn compare(a: &[u8], b: &[u8]) -> (usize, u8) {
    assert_eq!(a.len(), b.len());
    let differences = || a.iter().zip(b).map(|(a, b)| a.abs_diff(*b));
    (differences().filter(|d| *d > 0).count(), differences().max().unwrap_or(0))
}

/// Every picture with every curve, whole and in part, marked and not: what the shader draws is what its twin says.
#[test]
fn panes_are_what_the_twin_says() {
    let gpu = gpu();
    let (.., device, queue) = gpu.parts();
    let mut screen = Screen::new(device, TextureFormat::Rgba8Unorm);
    let kinds = Arc::new(Kinds::new(&Pattern::built_in("mpve-1-4").unwrap()));
    let (mut values, mut off) = (0, 0);
    for (height, width) in [(33, 17), (40, 64)] {
        let frame = Arc::new(frame(height, width));
        for (i, curve) in Curve::ALL.into_iter().enumerate() {
            for (part, marked) in [
                (Part { rows: 0..height, cols: 0..width, stride: 1 }, false),
                (Part { rows: 3..height, cols: 2..width, stride: 1 }, true),
                (Part { rows: 0..height, cols: 0..width, stride: 3 }, i % 2 == 0),
            ] {
                let exposure = i as f32 - 1.5;
                let display =
                    Display { curve, exposure, clipping: marked, dither: i % 2 == 0, difference: 0.3 };
                let table = Arc::new(ToneTable::new(display));
                for picture in Picture::ALL {
                    let (frame, kinds, table, part) =
                        (Arc::clone(&frame), Arc::clone(&kinds), Arc::clone(&table), part.clone());
                    let expected = picture.pixels(&frame, &kinds, &part, &table, marked);
                    let shown = Shown { frame, picture, part, kinds, table, marked };
                    let found = drawn(&mut screen, &queue, &shown);
                    let (differ, most) = compare(&found, &expected);
                    assert!(most <= 1, "{picture:?} {curve:?} {:?}: {most}", shown.part);
                    (values, off) = (values + found.len(), off + differ);
                }
            }
        }
    }
    assert!(100 * off < values, "{off} of {values} values are one step off");
    gpu.check().unwrap();
}

fn capture(height: usize, width: usize) -> Capture {
    let light = |i: usize| ((i * 31 % 97) as f32 / 97.0).powi(3);
    let video = Video::new(40, height, width, (0..40 * height * width).map(light).collect()).unwrap();
    Sampler::new(Pattern::built_in("mpve-1-4").unwrap(), Form::Linear).unwrap().sample(&video).unwrap()
}

/// Frames that the net left on the GPU are drawn as the same frames from main memory are; where the frame is no
/// multiple of the net's granularity too.
#[test]
fn results_that_stay_on_the_gpu_are_drawn_as_those_from_main_memory() {
    let gpu = gpu();
    let (.., device, queue) = gpu.parts();
    let mut screen = Screen::new(device, TextureFormat::Rgba8Unorm);
    let results = gpu.results().unwrap();
    let model = Model::load("tiny").unwrap();
    for precision in [Precision::F32, Precision::F16] {
        for (height, width) in [(16, 24), (18, 21)] {
            let capture = capture(height, width);
            let backend = Backend::Gpu(gpu.clone(), precision);
            let mut synthesizer = Synthesizer::new(
                &model,
                capture.calibration(),
                [height, width],
                &backend,
                &Settings::default(),
            )
            .unwrap();
            results.begin(true);
            let mut frames = Vec::new();
            let start = capture.recording().info.schedule_start;
            synthesizer
                .run(&capture, |number, values| {
                    let on_gpu = results.take(start + number as i64);
                    let (ours, truth) = (Some(values.to_vec()), Some(values.to_vec()));
                    frames.push(Frame { number, height, width, ours, truth, on_gpu, ..Frame::default() });
                    Ok(())
                })
                .unwrap();
            assert_eq!(frames.len(), 40);
            for frame in frames.into_iter().step_by(7) {
                assert!(frame.on_gpu.is_some(), "frame {} is not on the GPU", frame.number);
                let below = Frame { on_gpu: None, ..frame.clone() };
                // What is in main memory is not looked at.
                let above = Frame { ours: Some(vec![0.0; height * width]), ..frame };
                let [kept, uploaded] = [above, below].map(|frame| {
                    let shown = Shown {
                        frame: Arc::new(frame),
                        picture: Picture::Ours,
                        part: Part { rows: 0..height, cols: 0..width, stride: 1 },
                        kinds: Arc::default(),
                        table: Arc::new(ToneTable::new(Display::default())),
                        marked: false,
                    };
                    drawn(&mut screen, &queue, &shown)
                });
                assert!(uploaded.iter().any(|byte| *byte > 50));
                assert_eq!(compare(&kept, &uploaded), (0, 0));
            }
        }
    }
    // What is not wanted takes no memory.
    results.begin(false);
    let capture = capture(16, 24);
    let backend = Backend::Gpu(gpu.clone(), Precision::F32);
    Synthesizer::new(&model, capture.calibration(), [16, 24], &backend, &Settings::default())
        .unwrap()
        .video(&capture)
        .unwrap();
    assert!(results.take(0).is_none());
    gpu.check().unwrap();
}
