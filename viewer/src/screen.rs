//! Pictures on the GPU that draws the window: from the planes of a frame to the screen.
//!
//! There is one way for all of them. A compute shader makes a picture's colours at its own resolution, only when
//! something about it has changed; a quad shows them. It reads planes where they are: results that the network left on
//! the same device, or what is uploaded from main memory, once a frame.

use std::sync::Arc;

use bytemuck::{Pod, Zeroable};
use eframe::egui::{PaintCallbackInfo, Pos2, Rect};
use eframe::egui_wgpu::{CallbackResources, CallbackTrait, RenderState, ScreenDescriptor};
use wgpu::util::DeviceExt;
use wgpu::{
    BindGroupEntry, BindGroupLayoutEntry, BindingResource, BindingType, BufferBindingType, BufferUsages,
    ComputePassDescriptor, ShaderStages, TextureFormat, TextureUsages,
};

use crate::frame::{Frame, Plane};
use crate::picture::{COMPUTED, Kinds, Picture};
use crate::place::Part;
use crate::tone::{BAYER, CLIPPED, COLOURS, Curve, DIVERGING, MANTISSA, ToneTable};
use pix2hdr::gpu::shader::{Parameters, Source, Value, dump, specialise};

const PICTURE: Source =
    Source { path: "viewer/shaders/picture.wgsl", text: include_str!("../shaders/picture.wgsl") };
const PANE: Source = Source { path: "viewer/shaders/pane.wgsl", text: include_str!("../shaders/pane.wgsl") };

/// Rows and columns of pixels that a workgroup computes.
const BLOCK: usize = 8;
/// What a picture shows, and so how it is computed.
const IRRADIANCE: u32 = 0;
const RAW: u32 = 1;
const SUB_FRAMES: u32 = 2;
const DIFFERENCE: u32 = 3;
/// Where no pixel of a sub-frame stands.
const NO_SOURCE: u32 = u32::MAX;

/// What a pane shows.
#[derive(Clone)]
pub(crate) struct Shown {
    pub(crate) frame: Arc<Frame>,
    pub(crate) picture: Picture,
    pub(crate) part: Part,
    pub(crate) kinds: Arc<Kinds>,
    pub(crate) table: Arc<ToneTable>,
    /// Whether computed cells are marked.
    pub(crate) marked: bool,
}

impl PartialEq for Shown {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.frame, &other.frame)
            && Arc::ptr_eq(&self.kinds, &other.kinds)
            && Arc::ptr_eq(&self.table, &other.table)
            && (self.picture, &self.part, self.marked) == (other.picture, &other.part, other.marked)
    }
}

/// A pane's picture, to be drawn with the rest of the interface.
pub(crate) struct Painting {
    /// Number of the pane.
    pub(crate) pane: usize,
    /// What it shows; nothing is black.
    pub(crate) shown: Option<Shown>,
    /// Where the part is, in points of the screen.
    pub(crate) rect: Rect,
    /// What of the screen shows it, black around it.
    pub(crate) around: Rect,
    /// Whether its pixels are seen as such, instead of being interpolated.
    pub(crate) sharp: bool,
}

impl CallbackTrait for Painting {
    fn prepare(
        &self,
        _: &wgpu::Device,
        queue: &wgpu::Queue,
        screen: &ScreenDescriptor,
        encoder: &mut wgpu::CommandEncoder,
        resources: &mut CallbackResources,
    ) -> Vec<wgpu::CommandBuffer> {
        if let Some(drawn) = resources.get_mut::<Screen>() {
            drawn.prepare(self, queue, screen, encoder);
        }
        Vec::new()
    }

    fn paint(
        &self,
        info: PaintCallbackInfo,
        pass: &mut wgpu::RenderPass<'static>,
        resources: &CallbackResources,
    ) {
        if let Some(screen) = resources.get::<Screen>() {
            screen.paint(self, info.screen_size_px, pass);
        }
    }
}

/// What draws pictures; egui keeps it among its callbacks' resources.
pub struct Screen {
    device: wgpu::Device,
    colouring: wgpu::ComputePipeline,
    drawing: wgpu::RenderPipeline,
    /// Interpolated and sharp.
    samplers: [wgpu::Sampler; 2],
    /// For bindings that a picture does not use.
    nothing: wgpu::Buffer,
    panes: Vec<Option<Drawn>>,
    /// Planes of the frame that is shown.
    frame: Option<Arc<Frame>>,
    planes: [Option<wgpu::Buffer>; 4],
    table: Option<(Arc<ToneTable>, wgpu::Buffer)>,
    sources: Option<(Arc<Kinds>, [usize; 2], wgpu::Buffer)>,
}

/// A pane's picture as it was last drawn.
struct Drawn {
    shown: Option<Shown>,
    texture: wgpu::Texture,
    view: wgpu::TextureView,
    part: wgpu::Buffer,
    place: wgpu::Buffer,
    /// For the samplers.
    bindings: [wgpu::BindGroup; 2],
}

/// A plane where it is: its buffer, and how its rows lie in it.
struct Placed {
    buffer: wgpu::Buffer,
    first: u32,
    pitch: u32,
}

/// As `shaders/picture.wgsl` has it.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct PartUniform {
    row: u32,
    col: u32,
    stride: u32,
    kind: u32,
    height: u32,
    width: u32,
    rows: u32,
    cols: u32,
    first: [u32; 2],
    pitch: [u32; 2],
    clipping: u32,
    dither: u32,
    false_colour: u32,
    gain: f32,
    difference: f32,
    cell_rows: u32,
    cell_cols: u32,
    cells: u32,
    padding: u32,
}

impl Screen {
    /// Gives egui what it needs to draw panes.
    pub fn install(state: &RenderState) {
        let screen = Self::new(state.device.clone(), state.target_format);
        state.renderer.write().callback_resources.insert(screen);
    }

    fn new(device: wgpu::Device, target: TextureFormat) -> Self {
        let module = |label, text: String| {
            let source = wgpu::ShaderSource::Wgsl(text.into());
            device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source })
        };
        let layout = |label, entries: &[BindGroupLayoutEntry]| {
            let layout = device
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries });
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(label),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            })
        };
        let entry = |visibility: ShaderStages, binding: u32, ty: BindingType| BindGroupLayoutEntry {
            binding,
            visibility,
            ty,
            count: None,
        };
        let buffer = |ty| BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
        let storage = buffer(BufferBindingType::Storage { read_only: true });
        let mut bindings = vec![entry(ShaderStages::COMPUTE, 0, buffer(BufferBindingType::Uniform))];
        bindings.extend((1..6).map(|binding| entry(ShaderStages::COMPUTE, binding, storage)));
        let target_texture = BindingType::StorageTexture {
            access: wgpu::StorageTextureAccess::WriteOnly,
            format: TextureFormat::Rgba8Unorm,
            view_dimension: wgpu::TextureViewDimension::D2,
        };
        bindings.push(entry(ShaderStages::COMPUTE, 6, target_texture));
        let text = |name, source, parameters| {
            let shader = specialise(source, &parameters);
            dump(&[name], &shader);
            shader.text
        };
        let picture = text("picture", PICTURE, parameters());
        let colouring = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some("picture"),
            layout: Some(&layout("picture", &bindings)),
            module: &module("picture", picture),
            entry_point: Some("picture"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        });
        let sampled = BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: true },
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: false,
        };
        let bindings = [
            entry(ShaderStages::VERTEX, 0, buffer(BufferBindingType::Uniform)),
            entry(ShaderStages::FRAGMENT, 1, sampled),
            entry(ShaderStages::FRAGMENT, 2, BindingType::Sampler(wgpu::SamplerBindingType::Filtering)),
        ];
        let pane = module("pane", text("pane", PANE, Parameters::default()));
        let drawing = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("pane"),
            layout: Some(&layout("pane", &bindings)),
            vertex: wgpu::VertexState {
                module: &pane,
                entry_point: Some("corner"),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState {
                topology: wgpu::PrimitiveTopology::TriangleStrip,
                ..Default::default()
            },
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &pane,
                entry_point: Some(if target.is_srgb() { "shown_encoded" } else { "shown" }),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &[Some(target.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let sampler = |filter| {
            device.create_sampler(&wgpu::SamplerDescriptor {
                mag_filter: filter,
                min_filter: filter,
                ..Default::default()
            })
        };
        let samplers = [wgpu::FilterMode::Linear, wgpu::FilterMode::Nearest].map(sampler);
        let nothing = storage_buffer(&device, "nothing", &[0_u32; 4]);
        Self {
            device,
            colouring,
            drawing,
            samplers,
            nothing,
            panes: Vec::new(),
            frame: None,
            planes: [const { None }; 4],
            table: None,
            sources: None,
        }
    }

    /// Makes the picture's colours anew if something about it has changed, and says where it goes.
    fn prepare(
        &mut self,
        painting: &Painting,
        queue: &wgpu::Queue,
        screen: &ScreenDescriptor,
        encoder: &mut wgpu::CommandEncoder,
    ) {
        let Painting { pane, shown, rect, around, .. } = painting;
        if self.panes.len() <= *pane {
            self.panes.resize_with(pane + 1, || None);
        }
        let last = self.panes[*pane].take();
        let drawn = match last {
            Some(drawn) if drawn.shown == *shown => Some(drawn),
            last => match shown {
                Some(shown) => self.colour(shown, last, queue, encoder),
                // A new texture is black.
                None => Some(self.target(None, [1, 1])),
            },
        };
        if let Some(drawn) = &drawn {
            let [width, height] = screen.size_in_pixels.map(|side| side as f32 / screen.pixels_per_point);
            let place = |at: Pos2| [2.0 * at.x / width - 1.0, 1.0 - 2.0 * at.y / height];
            let within =
                |at: Pos2| [(at.x - rect.left()) / rect.width(), (at.y - rect.top()) / rect.height()];
            let corners = [around.min, around.max];
            let place = [corners.map(place), corners.map(within)];
            queue.write_buffer(&drawn.place, 0, bytemuck::cast_slice(place.as_flattened()));
        }
        self.panes[*pane] = drawn;
    }

    fn paint(&self, painting: &Painting, screen: [u32; 2], pass: &mut wgpu::RenderPass<'static>) {
        let Some(drawn) = self.panes.get(painting.pane).and_then(Option::as_ref) else { return };
        // What of it is seen is what egui's scissors leave.
        let [width, height] = screen.map(|side| side as f32);
        pass.set_viewport(0.0, 0.0, width, height, 0.0, 1.0);
        pass.set_pipeline(&self.drawing);
        pass.set_bind_group(0, &drawn.bindings[usize::from(painting.sharp)], &[]);
        pass.draw(0..4, 0..1);
    }

    /// Records the computation of a picture's colours; `None` if this device cannot hold it.
    fn colour(
        &mut self,
        shown: &Shown,
        last: Option<Drawn>,
        queue: &wgpu::Queue,
        encoder: &mut wgpu::CommandEncoder,
    ) -> Option<Drawn> {
        let Shown { frame, picture, part, kinds, table, marked } = shown;
        let (first, second) = picture.planes();
        let plane = self.plane(frame, first, queue)?;
        let other = match second {
            Some(second) => self.plane(frame, second, queue)?,
            None => Placed { buffer: self.nothing.clone(), first: 0, pitch: 0 },
        };
        let display = table.display();
        let extent = [frame.height, frame.width];
        let [rows, cols] = part.extent();
        let limit = self.device.limits().max_texture_dimension_2d as usize;
        if rows.max(cols) > limit {
            return None;
        }
        let cells = frame.computed.as_ref().filter(|_| *marked && picture.shows_cells());
        let mut uniform = PartUniform {
            row: part.rows.start as u32,
            col: part.cols.start as u32,
            stride: part.stride as u32,
            height: frame.height as u32,
            width: frame.width as u32,
            rows: rows as u32,
            cols: cols as u32,
            first: [plane.first, other.first],
            pitch: [plane.pitch, other.pitch],
            kind: match picture {
                Picture::Mosaic => RAW,
                Picture::SubFrames => SUB_FRAMES,
                Picture::Difference | Picture::FilteredDifference => DIFFERENCE,
                Picture::Filtered | Picture::Ours | Picture::Truth => IRRADIANCE,
            },
            clipping: display.clipping.into(),
            dither: display.dither.into(),
            false_colour: (display.curve == Curve::FalseColour).into(),
            gain: display.exposure.exp2(),
            difference: display.difference,
            cell_rows: 0,
            cell_cols: 0,
            cells: 0,
            padding: 0,
        };
        let mut computed = self.nothing.clone();
        if let Some(cells) = cells {
            [uniform.cell_rows, uniform.cell_cols] = cells.cell.map(|side| side.max(1) as u32);
            uniform.cells = cells.active.extent()[2] as u32;
            let flags: Vec<u32> = cells.active.slab(cells.slab).iter().map(|cell| u32::from(*cell)).collect();
            computed = storage_buffer(&self.device, "computed cells", &flags);
        }
        let table = self.table(table);
        let sources = match picture {
            Picture::SubFrames => self.sources(kinds, extent),
            _ => self.nothing.clone(),
        };
        let target = match last {
            Some(drawn)
                if [drawn.texture.height(), drawn.texture.width()] == [uniform.rows, uniform.cols] =>
            {
                Drawn { shown: Some(shown.clone()), ..drawn }
            }
            _ => self.target(Some(shown), [rows, cols]),
        };
        queue.write_buffer(&target.part, 0, bytemuck::bytes_of(&uniform));
        let buffers = [&target.part, &plane.buffer, &other.buffer, &table, &sources, &computed];
        let resources = buffers
            .into_iter()
            .map(wgpu::Buffer::as_entire_binding)
            .chain([BindingResource::TextureView(&target.view)]);
        let entries: Vec<_> =
            (0..).zip(resources).map(|(binding, resource)| BindGroupEntry { binding, resource }).collect();
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &self.colouring.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut pass = encoder.begin_compute_pass(&ComputePassDescriptor::default());
        pass.set_pipeline(&self.colouring);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(cols.div_ceil(BLOCK) as u32, rows.div_ceil(BLOCK) as u32, 1);
        Some(target)
    }

    /// A texture for a picture of `rows` × `cols` pixels.
    fn target(&self, shown: Option<&Shown>, [rows, cols]: [usize; 2]) -> Drawn {
        let texture = self.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("picture"),
            size: wgpu::Extent3d { width: cols as u32, height: rows as u32, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: TextureFormat::Rgba8Unorm,
            usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
        let uniform = |label, size| {
            self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size,
                usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let part = uniform("part", size_of::<PartUniform>() as u64);
        let place = uniform("place", 32);
        let layout = self.drawing.get_bind_group_layout(0);
        let bindings = [0, 1].map(|sharp| {
            let sampler = BindingResource::Sampler(&self.samplers[sharp]);
            self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("pane"),
                layout: &layout,
                entries: &[
                    BindGroupEntry { binding: 0, resource: place.as_entire_binding() },
                    BindGroupEntry { binding: 1, resource: BindingResource::TextureView(&view) },
                    BindGroupEntry { binding: 2, resource: sampler },
                ],
            })
        });
        Drawn { shown: shown.cloned(), texture, view, part, place, bindings }
    }

    /// A plane of `frame`: where the GPU left it, or uploaded. `None` if there is none, or if it is too large.
    fn plane(&mut self, frame: &Arc<Frame>, plane: Plane, queue: &wgpu::Queue) -> Option<Placed> {
        let kept = frame.on_gpu.as_ref().filter(|kept| plane == Plane::Ours && kept.device == self.device);
        if let Some(kept) = kept {
            let (first, pitch) = (u32::try_from(kept.offset).ok()?, kept.row as u32);
            return Some(Placed { buffer: kept.buffer.clone(), first, pitch });
        }
        let values = frame.plane(plane)?;
        if self.frame.as_ref().is_none_or(|last| !Arc::ptr_eq(last, frame)) {
            self.frame = Some(Arc::clone(frame));
            self.planes = [const { None }; 4];
        }
        let bytes: &[u8] = bytemuck::cast_slice(values);
        let limits = self.device.limits();
        if bytes.len() as u64 > limits.max_storage_buffer_binding_size.min(limits.max_buffer_size) {
            return None;
        }
        let device = &self.device;
        let upload = || {
            let buffer = device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("plane"),
                size: bytes.len() as u64,
                usage: BufferUsages::STORAGE | BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            queue.write_buffer(&buffer, 0, bytes);
            buffer
        };
        let buffer = self.planes[plane as usize].get_or_insert_with(upload).clone();
        Some(Placed { buffer, first: 0, pitch: frame.width as u32 })
    }

    fn table(&mut self, table: &Arc<ToneTable>) -> wgpu::Buffer {
        if let Some((_, buffer)) = self.table.as_ref().filter(|(last, _)| Arc::ptr_eq(last, table)) {
            return buffer.clone();
        }
        let buffer = storage_buffer(&self.device, "tone curve", table.entries());
        self.table = Some((Arc::clone(table), buffer.clone()));
        buffer
    }

    /// Which pixel stands where among sub-frames.
    fn sources(&mut self, kinds: &Arc<Kinds>, extent: [usize; 2]) -> wgpu::Buffer {
        let same = |last: &Arc<Kinds>, of: [usize; 2]| Arc::ptr_eq(last, kinds) && of == extent;
        if let Some((.., buffer)) = self.sources.as_ref().filter(|(last, of, _)| same(last, *of)) {
            return buffer.clone();
        }
        let [height, width] = extent;
        let source = |(y, x)| kinds.source(y, x, extent).map_or(NO_SOURCE, |(y, x)| (y * width + x) as u32);
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (y, x)));
        let sources: Vec<u32> = places.map(source).collect();
        let buffer = storage_buffer(&self.device, "sub-frames", &sources);
        self.sources = Some((Arc::clone(kinds), extent, buffer.clone()));
        buffer
    }
}

/// A buffer that shaders read.
fn storage_buffer<T: Pod>(device: &wgpu::Device, label: &str, values: &[T]) -> wgpu::Buffer {
    device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: Some(label),
        contents: bytemuck::cast_slice(values),
        usage: BufferUsages::STORAGE,
    })
}

/// What the shader has from the twin.
fn parameters() -> Parameters {
    let colour = |[r, g, b]: [u8; 3]| format!("vec3<f32>({r}.0, {g}.0, {b}.0)");
    let mut parameters = Parameters::default();
    parameters.set("block", BLOCK);
    parameters.set("clipped", Value::Other(colour(CLIPPED)));
    parameters.set("computed", Value::Other(colour(COMPUTED)));
    for (name, colours) in [("colours", &COLOURS[..]), ("diverging", &DIVERGING)] {
        parameters.set(name, Value::array("vec3<f32>", colours.iter().map(|c| colour(*c))));
        parameters.set(&format!("{name}_len"), colours.len() as f32);
    }
    let thresholds = BAYER.as_flattened().iter().map(|&threshold| Value::Float(threshold.into()));
    parameters.set("bayer", Value::array("f32", thresholds));
    for (name, kind) in [("raw", RAW), ("sub_frames", SUB_FRAMES), ("difference", DIFFERENCE)] {
        parameters.set(name, kind);
    }
    parameters.set("no_source", NO_SOURCE);
    parameters.set("mantissa", MANTISSA);
    parameters.set("table_first", ToneTable::FIRST);
    parameters
}

#[cfg(test)]
#[path = "../tests/support/offscreen.rs"]
mod offscreen;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Computed;
    use crate::tone::Display;
    use eframe::egui::{pos2, vec2};
    use pix2hdr::gpu::{AdapterChoice, Gpu};
    use pix2hdr::network::{Model, Precision};
    use pix2hdr::sensor::{Capture, Form, Pattern, Sampler};
    use pix2hdr::synth::{Active, Backend, Synthesizer};
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
                    &pix2hdr::synth::Settings::default(),
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
        Synthesizer::new(
            &model,
            capture.calibration(),
            [16, 24],
            &backend,
            &pix2hdr::synth::Settings::default(),
        )
        .unwrap()
        .video(&capture)
        .unwrap();
        assert!(results.take(0).is_none());
        gpu.check().unwrap();
    }
}
