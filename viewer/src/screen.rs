//! Pictures on the GPU that draws the window: from the planes of a frame to the screen.
//!
//! There is one way for all of them. A compute shader makes a picture's colours at its own resolution, only when
//! something about it has changed; a quad shows them. It reads planes where they are: results that the network left on
//! the same device, or what is uploaded from main memory, once a frame.

mod pipelines;

use std::sync::Arc;

use bytemuck::Pod;
use eframe::egui::{PaintCallbackInfo, Pos2, Rect};
use eframe::egui_wgpu::{CallbackResources, CallbackTrait, RenderState, ScreenDescriptor};
use wgpu::util::DeviceExt;
use wgpu::{
    BindGroupEntry, BindingResource, BufferUsages, ComputePassDescriptor, TextureFormat, TextureUsages,
};

use crate::frame::{Frame, Plane};
use crate::picture::{Kinds, Picture};
use crate::place::Part;
use crate::tone::{Curve, ToneTable};
use pipelines::{BLOCK, DIFFERENCE, IRRADIANCE, NO_SOURCE, PartUniform, RAW, SUB_FRAMES};

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

impl Screen {
    /// Gives egui what it needs to draw panes.
    pub fn install(state: &RenderState) {
        let screen = Self::new(state.device.clone(), state.target_format);
        state.renderer.write().callback_resources.insert(screen);
    }

    fn new(device: wgpu::Device, target: TextureFormat) -> Self {
        let sampler = |filter| {
            device.create_sampler(&wgpu::SamplerDescriptor {
                mag_filter: filter,
                min_filter: filter,
                ..Default::default()
            })
        };
        Self {
            colouring: pipelines::colouring(&device),
            drawing: pipelines::drawing(&device, target),
            samplers: [wgpu::FilterMode::Linear, wgpu::FilterMode::Nearest].map(sampler),
            nothing: storage_buffer(&device, "nothing", &[0_u32; 4]),
            panes: Vec::new(),
            frame: None,
            planes: [const { None }; 4],
            table: None,
            sources: None,
            device,
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
        let extent = [frame.height, frame.width];
        let [rows, cols] = part.extent();
        let limit = self.device.limits().max_texture_dimension_2d as usize;
        if rows.max(cols) > limit {
            return None;
        }
        let mut uniform = uniform(shown, [&plane, &other]);
        let mut computed = self.nothing.clone();
        if let Some(cells) = frame.computed.as_ref().filter(|_| *marked && picture.shows_cells()) {
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

/// What the shader has to know of a picture, whose planes are where `planes` says; without marks on computed cells.
fn uniform(shown: &Shown, [plane, other]: [&Placed; 2]) -> PartUniform {
    let Shown { frame, picture, part, table, .. } = shown;
    let display = table.display();
    let [rows, cols] = part.extent();
    PartUniform {
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

#[cfg(test)]
mod tests;
