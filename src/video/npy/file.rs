//! The numbers of a NumPy file.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::super::VideoError;
use super::super::pixels::reserve;
use super::header::{Header, MAGIC, element_count, read_header};
use crate::Result;

/// A file whose header has been read and whose length is right.
#[derive(Debug)]
pub(super) struct Npy {
    pub header: Header,
    content: BufReader<File>,
    /// Where the numbers begin in the file.
    begin: u64,
    chunk: Chunk,
}

/// Frames of an array in Fortran order, which are spread over the whole file.
#[derive(Debug, Default)]
struct Chunk {
    /// The first of them.
    first: usize,
    /// Bytes of their numbers, [t, y, x].
    bytes: Vec<u8>,
}

/// Bytes of a [`Chunk`], or those of one frame if they are more.
const CHUNK_BYTES: usize = if cfg!(test) { 64 } else { 64 << 20 };

impl Npy {
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path)?;
        let meta = file.metadata()?;
        if !meta.is_file() {
            return Err(VideoError::Format("is not a file".into()).into());
        }
        let mut content = BufReader::with_capacity(1 << 20, file);
        let (header, begin) = read_header(&mut content)?;
        let data_len = meta.len().saturating_sub(begin);
        let declared = element_count(&header.shape).and_then(|n| n.checked_mul(header.kind.bytes()));
        let declared = declared.map_or(u64::MAX, |bytes| bytes as u64);
        let Header { shape, kind, .. } = &header;
        let promise = format!("its header promises {shape:?} of '{}'", kind.descr());
        if declared > data_len {
            let problem = format!("{promise}, but only {data_len} bytes follow: it is truncated");
            return Err(VideoError::Format(problem).into());
        }
        if declared < data_len {
            content.seek_relative(declared as i64)?;
            let mut next = Vec::new();
            content.by_ref().take(MAGIC.len() as u64).read_to_end(&mut next)?;
            let cause = if next == MAGIC {
                "another array; save one array a file"
            } else {
                "something else; if those are frames, write the header anew with their number"
            };
            let more = data_len - declared;
            return Err(
                VideoError::Format(format!("{promise}, but behind them {more} bytes hold {cause}")).into()
            );
        }
        if data_len == 0 {
            return Err(VideoError::Shape(format!("is empty: its shape is {:?}", header.shape)).into());
        }
        Ok(Self { header, content, begin, chunk: Chunk::default() })
    }

    /// All values in C order.
    pub fn values<const N: usize, T: Copy + Default>(
        &mut self,
        value: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>> {
        let values = self.values_at(0, self.header.shape.iter().product(), value)?;
        Ok(if self.header.fortran_order { c_order(&values, &self.header.shape)? } else { values })
    }

    /// The values [y, x] of frame `t` of an array [t, y, x], or of the only frame of one that is [y, x].
    pub fn frame<const N: usize, T: Copy + Default>(
        &mut self,
        t: usize,
        value: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>> {
        let len = self.header.frame_len();
        if !self.header.fortran_order {
            return self.values_at(t * len, len, value);
        }
        let there = self.chunk.bytes.len() / (len * N);
        if !(self.chunk.first..self.chunk.first + there).contains(&t) {
            self.read_block(t)?;
        }
        let bytes = &self.chunk.bytes[(t - self.chunk.first) * len * N..][..len * N];
        Ok(bytes.as_chunks().0.iter().map(|&bytes| value(bytes)).collect())
    }

    /// Reads frames of an array in Fortran order from frame `first` on: of each pixel, they stand side by side.
    fn read_block(&mut self, first: usize) -> Result<()> {
        let Header { kind, ref shape, .. } = self.header;
        let [frames, height, width] = match shape[..] {
            [height, width] => [1, height, width],
            [frames, height, width] => [frames, height, width],
            _ => unreachable!("an array of frames was opened"),
        };
        let (size, len) = (kind.bytes(), height * width);
        let count = (CHUNK_BYTES / (len * size)).clamp(1, frames - first);
        let mut bytes = reserve(count * len * size)?;
        bytes.resize(count * len * size, 0);
        let mut series = vec![0; count * size];
        // Without a buffer, which would read what lies between.
        let file = self.content.get_mut();
        for (y, x) in (0..width).flat_map(|x| (0..height).map(move |y| (y, x))) {
            let place = ((x * height + y) * frames + first) * size;
            file.seek(SeekFrom::Start(self.begin + place as u64))?;
            file.read_exact(&mut series)?;
            for (t, number) in series.chunks(size).enumerate() {
                bytes[(t * len + y * width + x) * size..][..size].copy_from_slice(number);
            }
        }
        // The buffer is of another place now.
        self.content.seek(SeekFrom::Start(self.begin))?;
        self.chunk = Chunk { first, bytes };
        Ok(())
    }

    /// `len` values of a file in its own order, from value number `first` on.
    fn values_at<const N: usize, T: Copy + Default>(
        &mut self,
        first: usize,
        len: usize,
        value: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>> {
        let (wanted, here) = (self.begin + (first * N) as u64, self.content.stream_position()?);
        self.content.seek_relative(wanted as i64 - here as i64)?;
        self.next(len, value)
    }

    /// The next `left` values in the file's order.
    fn next<const N: usize, T: Copy + Default>(
        &mut self,
        mut left: usize,
        value: impl Fn([u8; N]) -> T,
    ) -> Result<Vec<T>> {
        // One chunk of whole numbers at a time, so that the bytes are never all in memory beside the values.
        let mut chunk = vec![[0_u8; N]; left.min((1 << 18) / N)];
        let mut values = reserve(left)?;
        while left > 0 {
            let part = left.min(chunk.len());
            self.content.read_exact(chunk[..part].as_flattened_mut())?;
            values.extend(chunk[..part].iter().map(|&bytes| value(bytes)));
            left -= part;
        }
        Ok(values)
    }
}

/// Values in Fortran order (first axis fastest), put into C order.
fn c_order<T: Copy>(values: &[T], shape: &[usize]) -> Result<Vec<T>> {
    let mut ordered = reserve(values.len())?;
    let mut place = vec![0; shape.len()];
    for _ in 0..values.len() {
        let at = place.iter().zip(shape).rev().fold(0, |at, (&i, &n)| at * n + i);
        ordered.push(values[at]);
        for (i, &n) in place.iter_mut().zip(shape).rev() {
            *i += 1;
            if *i < n {
                break;
            }
            *i = 0;
        }
    }
    Ok(ordered)
}
