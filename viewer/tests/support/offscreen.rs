//! What would be on a screen, without one.

use wgpu::{BufferUsages, TextureUsages};

/// R, G and B of every pixel of a picture of `size` [width, height] in `format`. The commands before it are in `encoder`
/// and, submitted first, in `others`; `draw` draws it.
pub fn pixels(
    (device, queue): (&wgpu::Device, &wgpu::Queue),
    format: wgpu::TextureFormat,
    [width, height]: [u32; 2],
    mut encoder: wgpu::CommandEncoder,
    others: Vec<wgpu::CommandBuffer>,
    draw: impl FnOnce(&mut wgpu::RenderPass<'static>),
) -> Vec<u8> {
    let extent = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
    let target = device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: extent,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: TextureUsages::RENDER_ATTACHMENT | TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    let attachment = wgpu::RenderPassColorAttachment {
        view: &view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations::default(),
    };
    let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        color_attachments: &[Some(attachment)],
        ..Default::default()
    });
    draw(&mut pass.forget_lifetime());
    let pitch = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let copy = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(pitch * height),
        usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(pitch), rows_per_image: None };
    let to = wgpu::TexelCopyBufferInfo { buffer: &copy, layout };
    encoder.copy_texture_to_buffer(target.as_image_copy(), to, extent);
    queue.submit(others.into_iter().chain([encoder.finish()]));
    copy.map_async(wgpu::MapMode::Read, .., |mapped| mapped.unwrap());
    device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    let bytes = copy.get_mapped_range(..).unwrap();
    let row =
        |row: &[u8]| row[..4 * width as usize].chunks(4).flat_map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>();
    bytes.chunks(pitch as usize).flat_map(row).collect()
}
