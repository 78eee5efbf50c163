//! Validation of shaders without any driver, by the compiler that wgpu has.

use std::error::Error;

use naga::valid::{Capabilities, ValidationFlags, Validator};

use super::template::Shader;

/// What is wrong with a shader, and in which line of which file. `capabilities` are those of the adapter.
pub fn validate(shader: &Shader, capabilities: Capabilities) -> Result<naga::Module, String> {
    let source = &shader.text;
    let refused = |location: Option<naga::SourceLocation>, problem: String| {
        let line = location.map_or(0, |location| location.line_number as usize);
        let place = shader.origin(line).map(|(file, line)| format!("{file}:{line}"));
        format!("{}: {problem}", place.unwrap_or_else(|| "a shader".into()))
    };
    let module = naga::front::wgsl::parse_str(source)
        .map_err(|error| refused(error.location(source), error.message().to_owned()))?;
    Validator::new(ValidationFlags::all(), capabilities).validate(&module).map_err(|error| {
        let mut problem = error.as_inner().to_string();
        let mut cause = error.as_inner().source();
        while let Some(inner) = cause {
            problem = format!("{problem}: {inner}");
            cause = inner.source();
        }
        // The innermost part that is to blame.
        let spans = error.spans().filter_map(|(span, _)| span.to_range().map(|range| (range.len(), span)));
        let innermost = spans.min_by_key(|(len, _)| *len).map(|(_, span)| span.location(source));
        refused(innermost, problem)
    })?;
    check_geometry(shader, &module)?;
    Ok(module)
}

/// The uniform buffer is as large as the shader thinks.
fn check_geometry(shader: &Shader, module: &naga::Module) -> Result<(), String> {
    let geometry = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some("Geometry"));
    let bytes = |ty: &naga::Type| ty.inner.size(module.to_ctx()) as usize;
    let (declared, filled) = (geometry.map_or(0, |(_, ty)| bytes(ty)), 4 * shader.uniform().len());
    if filled != 0 && declared != filled {
        return Err(format!("the geometry has {declared} bytes and is filled with {filled}"));
    }
    Ok(())
}
