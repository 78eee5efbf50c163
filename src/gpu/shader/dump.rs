//! What is compiled, for people to read.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

use super::template::Shader;

/// The environment variable with the folder that shaders are written to.
const FOLDER: &str = "PIX2HDR_DUMP_SHADERS";

/// Writes what is compiled if the user asks for that by naming a folder in `PIX2HDR_DUMP_SHADERS`. `name` is the path of the
/// file in it, part by part, without its ending.
pub fn dump(name: &[&str], shader: &Shader) {
    let Some(folder) = env::var_os(FOLDER).filter(|folder| !folder.is_empty()) else { return };
    if let Err(error) = write(Path::new(&folder), name, shader) {
        tracing::warn!("shaders are not written to {}: {error}", folder.display());
    }
}

fn write(folder: &Path, name: &[&str], shader: &Shader) -> io::Result<PathBuf> {
    let mut path = folder.to_owned();
    path.extend(name.iter().map(|part| legible(part)));
    fs::create_dir_all(path.parent().unwrap_or(folder))?;
    path.as_mut_os_string().push(".wgsl");
    fs::write(&path, text(shader))?;
    Ok(path)
}

/// The text, behind the values of its geometry.
fn text(shader: &Shader) -> String {
    let geometry = shader.geometry().map(|(name, value)| format!("// {name} = {value}"));
    geometry.chain([shader.text.clone()]).collect::<Vec<_>>().join("\n")
}

/// A name without what folders and shells would trip over.
fn legible(name: &str) -> String {
    let kept = |c: char| if c.is_alphanumeric() || "-_×".contains(c) { c } else { '-' };
    name.chars().map(kept).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::shader::table::file;
    use crate::gpu::shader::{Parameters, specialise};

    #[test]
    fn steps_become_files() {
        let folder = tempfile::tempdir().unwrap();
        let mut parameters = Parameters::default();
        for name in ["workgroup_size", "weights_c", "weights_stride", "rendered_stride"] {
            parameters.set(name, 1_usize);
        }
        for name in ["invocations", "weights_offset", "rendered_offset", "output_offset"] {
            parameters.set(name, 17_usize);
        }
        let shader = specialise(file("fuse.wgsl"), &parameters);
        let path = write(folder.path(), &["net", "03-../a in b-fuse"], &shader).unwrap();
        assert_eq!(path, folder.path().join("net").join("03----a-in-b-fuse.wgsl"));
        let written = fs::read_to_string(path).unwrap();
        assert!(written.starts_with("// invocations = 17\n"), "{written}");
        assert!(written.contains("const WEIGHTS_C: i32 = 1;"), "{written}");
    }
}
