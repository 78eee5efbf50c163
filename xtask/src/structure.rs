//! Tests of how the source is put together: which module uses which, how long files and functions are, that one name means
//! one thing, and that documents name what is there.

mod documents;
mod modules;
mod names;
mod rules;
mod source;
