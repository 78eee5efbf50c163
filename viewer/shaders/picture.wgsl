// picture: planes [y, x] of a frame → colours as a pane shows them. Its CPU twin is `Picture::pixels`.
//
// One invocation computes one pixel of a part of the picture. The colours and codes are those of the twin.

//!include common/tone.wgsl

// Rows and columns of pixels that a workgroup computes.
const BLOCK: u32 = 8; //!parameter
const SATURATED: f32 = 0.98; //!parameter
// Colours of what is clipped and of cells that were computed; the false colours; from one sign of a difference to the other.
const CLIPPED = vec3<f32>(255.0, 0.0, 0.0); //!parameter
const COMPUTED = vec3<f32>(0.0, 0.0, 255.0); //!parameter
const COLOURS = array<vec3<f32>, 2>(vec3<f32>(0.0), vec3<f32>(255.0)); //!parameter
const COLOURS_LEN: f32 = 2.0; //!parameter
const DIVERGING = array<vec3<f32>, 2>(vec3<f32>(0.0), vec3<f32>(255.0)); //!parameter
const DIVERGING_LEN: f32 = 2.0; //!parameter
// Thresholds of ordered dithering, in sixteenths.
const BAYER = array<f32, 16>(0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5); //!parameter
// What a picture shows; anything else is irradiance.
const RAW: u32 = 1; //!parameter
const SUB_FRAMES: u32 = 2; //!parameter
const DIFFERENCE: u32 = 3; //!parameter
// Where no pixel of a sub-frame stands.
const NO_SOURCE: u32 = 0xffffffff; //!parameter
// Bits of the mantissa that the table of brightness knows, and where it begins.
const MANTISSA: u32 = 5; //!parameter
const TABLE_FIRST: u32 = 0; //!parameter

struct Part {
    // First row and column, and pixels of the frame from one that is shown to the next, which is the mean of them.
    row: u32,
    col: u32,
    stride: u32,
    kind: u32,
    // Of the frame, and of the part.
    height: u32,
    width: u32,
    rows: u32,
    cols: u32,
    // Values in front of each plane, and from one row to the next.
    first: vec2<u32>,
    pitch: vec2<u32>,
    clipping: u32,
    dither: u32,
    false_colour: u32,
    // 2^exposure, and the difference at the end of its scale.
    gain: f32,
    difference: f32,
    // Rows and columns of a cell, 0 where none is marked, and cells across.
    cell_rows: u32,
    cell_cols: u32,
    cells: u32,
}

@group(0) @binding(0) var<uniform> part: Part;
// The plane, and the one that it is compared with.
@group(0) @binding(1) var<storage, read> plane: array<f32>;
@group(0) @binding(2) var<storage, read> other: array<f32>;
// Brightness in [0, 255] by exponent and mantissa (`ToneTable`).
@group(0) @binding(3) var<storage, read> brightness: array<f32>;
// For sub-frames: which pixel stands where.
@group(0) @binding(4) var<storage, read> sources: array<u32>;
// Cells that were computed.
@group(0) @binding(5) var<storage, read> computed: array<u32>;
@group(0) @binding(6) var pixels: texture_storage_2d<rgba8unorm, write>;

// As the executors' results are read: what is not finite is black.
fn finite(value: f32) -> f32 {
    return select(value, 0.0, (bitcast<u32>(value) & 0x7f800000u) == 0x7f800000u);
}

// Mean over the square of `stride` pixels at row y, column x of a plane.
fn mean(y: u32, x: u32) -> vec2<f32> {
    var sum = vec2<f32>();
    var n = 0.0;
    for (var v = y; v < min(y + part.stride, part.height); v++) {
        for (var u = x; u < min(x + part.stride, part.width); u++) {
            let at = part.first + v * part.pitch + u;
            sum.x += finite(plane[at.x]);
            if (part.kind == DIFFERENCE) {
                sum.y += finite(other[at.y]);
            }
            n += 1.0;
        }
    }
    return sum / n;
}

// Brightness of irradiance p.
fn looked_up(p: f32) -> f32 {
    let bits = bitcast<u32>(p);
    // Zero and negative numbers.
    if (bits == 0u || bits >= 0x80000000u) {
        return 0.0;
    }
    let entry = max(bits >> (23u - MANTISSA), TABLE_FIRST) - TABLE_FIRST;
    return brightness[min(entry, arrayLength(&brightness) - 1u)];
}

// A byte of brightness in [0, 255], rounded one way or the other as the place says.
fn byte(value: f32, place: vec2<u32>) -> vec3<f32> {
    var thresholds = BAYER;
    let threshold = (thresholds[(place.y % 4u) * 4u + place.x % 4u] + 0.5) / 16.0;
    return vec3(clamp(floor(value + select(0.5, threshold, part.dither != 0u)), 0.0, 255.0));
}

// Of evenly spaced colours, the one at `at` in [0, 1].
fn false_colour(at: f32) -> vec3<f32> {
    var points = COLOURS;
    let place = clamp(at, 0.0, 1.0) * (COLOURS_LEN - 1.0);
    let i = min(u32(place), u32(COLOURS_LEN) - 2u);
    return floor(mix(points[i], points[i + 1u], place - f32(i)) + 0.5);
}

fn diverging(at: f32) -> vec3<f32> {
    var points = DIVERGING;
    let place = clamp(at, 0.0, 1.0) * (DIVERGING_LEN - 1.0);
    let i = min(u32(place), u32(DIVERGING_LEN) - 2u);
    return floor(mix(points[i], points[i + 1u], place - f32(i)) + 0.5);
}

fn irradiance(p: f32, place: vec2<u32>) -> vec3<f32> {
    if (part.clipping != 0u && p * part.gain >= 1.0) {
        return CLIPPED;
    }
    let value = looked_up(p);
    if (part.false_colour != 0u) {
        return false_colour(value / 255.0);
    }
    return byte(value, place);
}

fn pixel_value(y: f32, place: vec2<u32>) -> vec3<f32> {
    if (part.clipping != 0u && y >= SATURATED) {
        return CLIPPED;
    }
    if (part.false_colour != 0u) {
        return false_colour(y);
    }
    return byte(255.0 * clamp(y, 0.0, 1.0), place);
}

fn colour(y: u32, x: u32, place: vec2<u32>) -> vec3<f32> {
    switch part.kind {
        case RAW: {
            return pixel_value(finite(plane[part.first.x + y * part.pitch.x + x]), place);
        }
        case SUB_FRAMES: {
            let source = sources[y * part.width + x];
            if (source == NO_SOURCE) {
                return vec3(0.0);
            }
            let at = part.first.x + source / part.width * part.pitch.x + source % part.width;
            return pixel_value(finite(plane[at]), place);
        }
        case DIFFERENCE: {
            let p = clamp(mean(y, x), vec2(0.0), vec2(1.0));
            return diverging(0.5 + 0.5 * (tone(p.x) - tone(p.y)) / max(part.difference, 1e-6));
        }
        default: {
            return irradiance(mean(y, x).x, place);
        }
    }
}

@compute @workgroup_size(BLOCK, BLOCK)
fn picture(@builtin(global_invocation_id) at: vec3<u32>) {
    if (at.x >= part.cols || at.y >= part.rows) {
        return;
    }
    let y = part.row + at.y * part.stride;
    let x = part.col + at.x * part.stride;
    var found = colour(y, x, at.xy);
    if (part.cell_rows != 0u && computed[y / part.cell_rows * part.cells + x / part.cell_cols] != 0u) {
        found = floor(0.5 * (found + COMPUTED));
    }
    textureStore(pixels, at.xy, vec4(found / 255.0, 1.0));
}
