//! Threads that compress and write pictures.

use std::fs;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use super::super::exr::{self, PlaneWriting};
use super::names::frame_name;
use crate::{At, Error, Result};

/// Most threads that compress and write pictures.
const MAX_THREADS: usize = 8;

type Job = (usize, Vec<f32>);

/// What the threads of a pool do.
const WRITES: &str = "writes pictures";

/// Threads that write pictures. Few frames wait at a time, so that a slow disk slows the caller down instead of
/// filling the memory.
#[derive(Debug)]
pub(super) struct Pool {
    jobs: Option<SyncSender<Job>>,
    threads: Vec<JoinHandle<()>>,
    failure: Arc<Mutex<Option<Error>>>,
}

impl Pool {
    pub fn start(folder: &Path, width: usize, how: PlaneWriting) -> std::io::Result<Self> {
        let count = thread::available_parallelism().map_or(1, usize::from).min(MAX_THREADS);
        let (jobs, waiting) = sync_channel::<Job>(count);
        let waiting = Arc::new(Mutex::new(waiting));
        let mut pool = Self { jobs: Some(jobs), threads: Vec::new(), failure: Arc::default() };
        for _ in 0..count {
            let (folder, waiting, failure) = (folder.to_owned(), waiting.clone(), pool.failure.clone());
            let work = move || {
                while let Some((t, plane)) = next(&waiting) {
                    // A folder that was removed is not made anew: the frames in it are lost.
                    let there = fs::metadata(&folder).map(drop).at(&folder);
                    let path = folder.join(frame_name(t));
                    if let Err(error) = there.and_then(|()| exr::write(path, &plane, width, how)) {
                        failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                    }
                }
            };
            pool.threads.push(thread::Builder::new().name("write-exr".into()).spawn(work)?);
        }
        Ok(pool)
    }

    pub fn write(&self, t: usize, plane: Vec<f32>) -> Result<()> {
        self.check()?;
        let sent = self.jobs.as_ref().is_some_and(|jobs| jobs.send((t, plane)).is_ok());
        if sent { Ok(()) } else { Err(Error::Panicked(WRITES)) }
    }

    /// Waits for all that was given to the pool.
    pub fn join(&mut self) -> Result<()> {
        self.jobs = None;
        let ends: Vec<_> = self.threads.drain(..).map(JoinHandle::join).collect();
        let panicked = ends.iter().any(thread::Result::is_err);
        self.check()?;
        if panicked { Err(Error::Panicked(WRITES)) } else { Ok(()) }
    }

    fn check(&self) -> Result<()> {
        match self.failure.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        // The threads must have left the folder before it is removed; their failures no longer matter.
        let _ = self.join();
    }
}

fn next(waiting: &Mutex<Receiver<Job>>) -> Option<Job> {
    waiting.lock().unwrap_or_else(PoisonError::into_inner).recv().ok()
}
