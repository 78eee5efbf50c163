//! What takes result frames.

use std::path::PathBuf;

use crate::Result;
use crate::error::ModuleError;
use crate::synth::{Report, ResultFrame};
use crate::video::PreviewWriter;

/// Takes result frames in order. Several sinks are one as a tuple; one that is not wanted is `None`.
pub trait Sink: Send {
    /// What is there when all frames are.
    type Output;

    /// How many frames an earlier run left: the run goes on behind them.
    fn begun(&self) -> usize {
        0
    }

    /// Takes the next frame.
    fn take(&mut self, result: &ResultFrame) -> Result<()>;

    /// All frames are there, and `run` says how they were made.
    fn finish(self, run: &Report) -> Result<Self::Output>;

    /// No more frames come, though some are missing: leaves what there is, and says what that is.
    fn suspend(self) -> Result<Option<Left>>
    where
        Self: Sized,
    {
        Ok(None)
    }
}

/// What a run that ended early left.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{}", self.words())]
pub struct Left {
    /// Frames that are there, those of earlier runs included.
    pub done: usize,
    /// Frames that there were to be.
    pub frames: usize,
    /// Where they are.
    pub partial: PathBuf,
}

impl ModuleError for Left {}

impl Left {
    fn words(&self) -> String {
        let Self { done, frames, partial } = self;
        if *done == 0 {
            return "stopped before the first frame; nothing is left".into();
        }
        let partial = partial.display();
        format!("stopped after {done} of {frames} frames, which are in {partial}; go on with --resume")
    }
}

/// Gives each frame to a function.
pub struct Each<F>(pub F);

impl<F: FnMut(&ResultFrame) -> Result<()> + Send> Sink for Each<F> {
    type Output = ();

    fn take(&mut self, result: &ResultFrame) -> Result<()> {
        (self.0)(result)
    }

    fn finish(self, _: &Report) -> Result<()> {
        Ok(())
    }
}

impl<S: Sink> Sink for Option<S> {
    type Output = Option<S::Output>;

    fn begun(&self) -> usize {
        self.as_ref().map_or(0, Sink::begun)
    }

    fn take(&mut self, result: &ResultFrame) -> Result<()> {
        self.as_mut().map_or(Ok(()), |sink| sink.take(result))
    }

    fn finish(self, run: &Report) -> Result<Self::Output> {
        self.map(|sink| sink.finish(run)).transpose()
    }

    fn suspend(self) -> Result<Option<Left>> {
        self.map_or(Ok(None), Sink::suspend)
    }
}

/// Sinks one after the other.
macro_rules! sinks {
    ($($name:ident $place:tt),*) => {
        impl<$($name: Sink),*> Sink for ($($name,)*) {
            type Output = ($($name::Output,)*);

            fn begun(&self) -> usize {
                [$(self.$place.begun()),*].into_iter().max().unwrap_or(0)
            }

            fn take(&mut self, result: &ResultFrame) -> Result<()> {
                $(self.$place.take(result)?;)*
                Ok(())
            }

            fn finish(self, run: &Report) -> Result<Self::Output> {
                Ok(($(self.$place.finish(run)?,)*))
            }

            /// All of them, whatever becomes of the others.
            fn suspend(self) -> Result<Option<Left>> {
                let all = [$(self.$place.suspend()),*];
                all.into_iter().reduce(|one, other| Ok(one?.or(other?))).unwrap_or(Ok(None))
            }
        }
    };
}

sinks!(A 0, B 1);
sinks!(A 0, B 1, C 2);
sinks!(A 0, B 1, C 2, D 3);

/// A preview video.
impl Sink for PreviewWriter {
    type Output = PathBuf;

    fn take(&mut self, result: &ResultFrame) -> Result<()> {
        self.push(result.frame.values())
    }

    fn finish(self, _: &Report) -> Result<PathBuf> {
        PreviewWriter::finish(self)
    }
}
