//! Tests of how the source is put together: which module uses which, how long files and functions are, and that documents
//! name what is there.

mod documents;
mod modules;
mod rules;
mod source;
