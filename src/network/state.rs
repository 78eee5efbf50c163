//! What a window leaves for the one behind it.

use std::any::Any;
use std::fmt;

use crate::{Error, Result};

/// What the windows of a sequence leave for each other: the last frames of some layers.
///
/// A sequence is a part of a recording whose windows are computed in order, such as one tile in one pose. Whoever goes
/// through it has its state made by the executor ([`Executor::state`](super::Executor::state)) and hands it over with
/// each window. A window right behind the last one computes only what is new; any other one begins the sequence anew.
/// Results are the same.
pub struct State {
    /// Schedule time at which the window right behind the last one begins.
    next: Option<i64>,
    /// What is left, as the executor keeps it.
    left: Box<dyn Any + Send>,
}

impl State {
    /// Of a sequence of which no window was computed. `left` is where an executor keeps what windows leave.
    pub(crate) fn new(left: impl Any + Send) -> Self {
        Self { next: None, left: Box::new(left) }
    }

    /// Goes on to a window of `hop` result frames that begins at `schedule`; whether it lies right behind the last one.
    pub(crate) fn advance(&mut self, schedule: i64, hop: usize) -> bool {
        let follows = self.next == Some(schedule);
        self.next = Some(schedule.wrapping_add(hop as i64));
        follows
    }

    /// Forgets what windows have left: the next one begins the sequence anew.
    pub fn forget(&mut self) {
        self.next = None;
    }

    /// What windows have left, as the executor keeps it that made the state.
    pub(crate) fn left<T: Any>(&mut self) -> Result<&mut T> {
        self.left.downcast_mut().ok_or_else(|| Error::Misuse("a state of another kind of executor".into()))
    }
}

impl fmt::Debug for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("State").field("next", &self.next).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_window_right_behind_follows() {
        let mut state = State::new(vec![0.0f32]);
        assert!(!state.advance(16, 8));
        assert!(state.advance(24, 8));
        assert!(!state.advance(24, 8), "the same one again");
        assert!(!state.advance(40, 8), "one is missing");
        assert!(state.advance(48, 8));
        state.forget();
        assert!(!state.advance(56, 8));
        assert!(state.left::<Vec<f32>>().is_ok() && state.left::<Vec<f64>>().is_err());
    }
}
