//! The pipelines that draw pictures, and what they share with their shaders.

use bytemuck::{Pod, Zeroable};
use wgpu::{BindGroupLayoutEntry, BindingType, BufferBindingType, ShaderStages, TextureFormat};

use crate::picture::COMPUTED;
use crate::tone::{BAYER, CLIPPED, COLOURS, DIVERGING, MANTISSA, ToneTable};
use pix2hdr::gpu::shader::{Parameters, ShaderFile, Value, dump, specialise};

const PICTURE: ShaderFile =
    ShaderFile { path: "viewer/shaders/picture.wgsl", text: include_str!("../../shaders/picture.wgsl") };
const PANE: ShaderFile =
    ShaderFile { path: "viewer/shaders/pane.wgsl", text: include_str!("../../shaders/pane.wgsl") };

/// Rows and columns of pixels that a workgroup computes.
pub(super) const BLOCK: usize = 8;

/// What a picture shows, and so how it is computed.
pub(super) const IRRADIANCE: u32 = 0;
pub(super) const RAW: u32 = 1;
pub(super) const SUB_FRAMES: u32 = 2;
pub(super) const DIFFERENCE: u32 = 3;
/// Where no pixel of a sub-frame stands.
pub(super) const NO_SOURCE: u32 = u32::MAX;

/// As `shaders/picture.wgsl` has it.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct PartUniform {
    pub(super) row: u32,
    pub(super) col: u32,
    pub(super) stride: u32,
    pub(super) kind: u32,
    pub(super) height: u32,
    pub(super) width: u32,
    pub(super) rows: u32,
    pub(super) cols: u32,
    pub(super) first: [u32; 2],
    pub(super) pitch: [u32; 2],
    pub(super) clipping: u32,
    pub(super) dither: u32,
    pub(super) false_colour: u32,
    pub(super) gain: f32,
    pub(super) difference: f32,
    pub(super) cell_rows: u32,
    pub(super) cell_cols: u32,
    pub(super) cells: u32,
    pub(super) padding: u32,
}

/// Makes a picture's colours (`shaders/picture.wgsl`).
pub(super) fn colouring(device: &wgpu::Device) -> wgpu::ComputePipeline {
    let storage = buffer(BufferBindingType::Storage { read_only: true });
    let mut bindings = vec![entry(ShaderStages::COMPUTE, 0, buffer(BufferBindingType::Uniform))];
    bindings.extend((1..6).map(|binding| entry(ShaderStages::COMPUTE, binding, storage)));
    let texture = BindingType::StorageTexture {
        access: wgpu::StorageTextureAccess::WriteOnly,
        format: TextureFormat::Rgba8Unorm,
        view_dimension: wgpu::TextureViewDimension::D2,
    };
    bindings.push(entry(ShaderStages::COMPUTE, 6, texture));
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("picture"),
        layout: Some(&layout(device, "picture", &bindings)),
        module: &module(device, "picture", PICTURE, &parameters()),
        entry_point: Some("picture"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}

/// Shows them in a pane of a surface of format `target` (`shaders/pane.wgsl`).
pub(super) fn drawing(device: &wgpu::Device, target: TextureFormat) -> wgpu::RenderPipeline {
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
    let pane = module(device, "pane", PANE, &Parameters::default());
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("pane"),
        layout: Some(&layout(device, "pane", &bindings)),
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
    })
}

fn module(
    device: &wgpu::Device,
    label: &str,
    source: ShaderFile,
    parameters: &Parameters,
) -> wgpu::ShaderModule {
    let shader = specialise(source, parameters);
    dump(&[label], &shader);
    let source = wgpu::ShaderSource::Wgsl(shader.text.into());
    device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source })
}

fn layout(device: &wgpu::Device, label: &str, entries: &[BindGroupLayoutEntry]) -> wgpu::PipelineLayout {
    let layout =
        device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries });
    device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    })
}

fn entry(visibility: ShaderStages, binding: u32, ty: BindingType) -> BindGroupLayoutEntry {
    BindGroupLayoutEntry { binding, visibility, ty, count: None }
}

fn buffer(ty: BufferBindingType) -> BindingType {
    BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None }
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
