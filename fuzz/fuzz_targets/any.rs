//! Coverage-guided fuzzing of one reader: `PIX2HDR_READER=exr cargo +nightly fuzz run any --features libfuzzer`.

#![no_main]

use std::cell::OnceCell;

use libfuzzer_sys::fuzz_target;
use pix2hdr_fuzz::{Desk, Reader};

thread_local!(static DESK: OnceCell<(Desk, Reader)> = const { OnceCell::new() });

fuzz_target!(|data: &[u8]| {
    DESK.with(|desk| {
        let (desk, reader) = desk.get_or_init(|| {
            let name = std::env::var("PIX2HDR_READER").expect("PIX2HDR_READER names a reader");
            let reader =
                Reader::ALL.into_iter().find(|reader| reader.name() == name).expect("a known reader");
            (Desk::new().expect("a folder for files"), reader)
        });
        desk.read(*reader, data);
    });
});
