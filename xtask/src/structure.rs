//! Tests of how the source is put together: which module uses which, how long files and functions are, that one name means
//! one thing, that an operation or a format has one home, that the viewer builds nothing again, and that documents name
//! what is there.

mod documents;
mod features;
mod homes;
mod modules;
mod names;
mod rules;
mod source;
