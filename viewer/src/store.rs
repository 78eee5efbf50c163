//! The frames that are in memory, shared by the thread that computes them and the one that shows them.
//!
//! It is bounded in bytes. A live camera's frames push the oldest out. A file's frames wait at the door until the
//! playhead has moved on, so that nothing is lost and nothing computed far ahead of what is looked at.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::frame::Frame;

/// Least number of frames that are kept, however large they are.
const LEAST: usize = 16;
/// Most frames that are kept, however small they are: more than the time series can show.
const MOST: usize = 2048;

/// A number that changes whenever the frames begin anew; a run may only push under its own.
pub type Generation = u64;

/// A bounded store of frames, sorted by number.
#[derive(Debug)]
pub struct Store {
    bytes: usize,
    inner: Mutex<Inner>,
    moved: Condvar,
}

#[derive(Debug, Default)]
struct Inner {
    frames: VecDeque<Arc<Frame>>,
    generation: Generation,
    playhead: usize,
}

impl Store {
    /// A store of at most `bytes` bytes of frames (but at least a few of them).
    pub fn new(bytes: usize) -> Self {
        Self { bytes, inner: Mutex::default(), moved: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn room(&self, frame: &Frame) -> usize {
        (self.bytes / frame.bytes().max(1)).clamp(LEAST, MOST)
    }

    /// Forgets all frames. Whoever waits to push one under an older generation gives up.
    pub fn restart(&self, playhead: usize) -> Generation {
        let mut inner = self.lock();
        inner.frames.clear();
        inner.generation += 1;
        inner.playhead = playhead;
        self.moved.notify_all();
        inner.generation
    }

    /// Says which frame is looked at.
    pub fn move_to(&self, playhead: usize) {
        let mut inner = self.lock();
        if inner.playhead != playhead {
            inner.playhead = playhead;
            self.moved.notify_all();
        }
    }

    /// Adds a live camera's frame; the oldest one goes if there is no room. `false` if the generation has passed.
    pub fn push(&self, generation: Generation, frame: Frame) -> bool {
        let room = self.room(&frame);
        let mut inner = self.lock();
        if inner.generation != generation {
            return false;
        }
        while inner.frames.len() >= room {
            inner.frames.pop_front();
        }
        inner.frames.push_back(Arc::new(frame));
        true
    }

    /// Adds a file's frame. Waits for room: a quarter of the store stays behind the playhead, to step back to.
    /// `false` if the generation has passed.
    pub fn push_patiently(&self, generation: Generation, frame: Frame) -> bool {
        let room = self.room(&frame);
        let mut inner = self.lock();
        loop {
            if inner.generation != generation {
                return false;
            }
            if inner.frames.len() < room {
                break;
            }
            let oldest = inner.frames.front().map_or(0, |frame| frame.number);
            if oldest + room / 4 < inner.playhead {
                inner.frames.pop_front();
                continue;
            }
            inner = self.moved.wait(inner).unwrap_or_else(PoisonError::into_inner);
        }
        inner.frames.push_back(Arc::new(frame));
        true
    }

    /// The last frame whose number is at most `number`, or else the first one.
    pub fn at(&self, number: usize) -> Option<Arc<Frame>> {
        let inner = self.lock();
        let behind = inner.frames.partition_point(|frame| frame.number <= number);
        inner.frames.get(behind.saturating_sub(1)).cloned()
    }

    /// The first frame whose number is at least `number`.
    pub fn at_or_after(&self, number: usize) -> Option<Arc<Frame>> {
        let inner = self.lock();
        inner.frames.get(inner.frames.partition_point(|frame| frame.number < number)).cloned()
    }

    /// Numbers of the first and the last frame.
    pub fn span(&self) -> Option<[usize; 2]> {
        let inner = self.lock();
        Some([inner.frames.front()?.number, inner.frames.back()?.number])
    }

    /// The frames from number `first` to `last`, both included.
    pub fn between(&self, first: usize, last: usize) -> Vec<Arc<Frame>> {
        let inner = self.lock();
        inner.frames.iter().filter(|frame| (first..=last).contains(&frame.number)).cloned().collect()
    }

    /// Number of frames, and their bytes.
    pub fn size(&self) -> (usize, usize) {
        let inner = self.lock();
        (inner.frames.len(), inner.frames.iter().map(|frame| frame.bytes()).sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn frame(number: usize) -> Frame {
        Frame { number, height: 1, width: 1, ours: Some(vec![number as f32; 256]), ..Frame::default() }
    }

    #[test]
    fn a_live_store_drops_the_oldest_and_stays_within_its_bytes() {
        let store = Store::new(20 * 1024);
        let generation = store.restart(0);
        for number in (0..1000).filter(|n| n % 100 < 90) {
            assert!(store.push(generation, frame(number)));
        }
        assert_eq!(store.size(), (20, 20 * 1024));
        assert_eq!(store.span(), Some([970, 989]));
        assert_eq!(store.at(975).unwrap().number, 975);
        assert_eq!(store.at(5000).unwrap().number, 989);
        assert_eq!(store.at(3).unwrap().number, 970);
        assert_eq!(store.at_or_after(3).unwrap().number, 970);
        assert!(store.at_or_after(990).is_none());
    }

    #[test]
    fn a_new_generation_takes_nothing_of_the_old_one() {
        let store = Store::new(1 << 20);
        let old = store.restart(0);
        assert!(store.push(old, frame(1)));
        let new = store.restart(7);
        assert!(!store.push(old, frame(2)));
        assert!(!store.push_patiently(old, frame(2)));
        assert!(store.span().is_none());
        assert!(store.push(new, frame(7)));
    }

    /// A file's frames wait for the playhead, and none is lost.
    #[test]
    fn a_file_is_not_computed_far_ahead_of_the_playhead() {
        let store = Store::new(20 * 1024);
        let generation = store.restart(0);
        std::thread::scope(|scope| {
            let writer =
                scope.spawn(|| (0..100).take_while(|n| store.push_patiently(generation, frame(*n))).count());
            let mut seen = Vec::new();
            for number in 0..100 {
                while store.at(number).is_none_or(|frame| frame.number != number) {
                    std::thread::sleep(Duration::from_micros(200));
                    assert!(store.span().is_none_or(|[_, last]| last <= number + 20));
                }
                seen.push(number);
                store.move_to(number);
            }
            assert_eq!(seen.len(), 100);
            assert_eq!(writer.join().unwrap(), 100);
        });
        assert!(store.size().0 <= 20);
    }

    #[test]
    fn a_waiting_writer_gives_up_when_the_store_begins_anew() {
        let store = Store::new(1);
        let generation = store.restart(0);
        std::thread::scope(|scope| {
            let writer =
                scope.spawn(|| (0..1000).take_while(|n| store.push_patiently(generation, frame(*n))).count());
            while store.size().0 < LEAST {
                std::thread::yield_now();
            }
            store.restart(0);
            assert_eq!(writer.join().unwrap(), LEAST);
        });
    }
}
