//! What the shader of a kernel reads and writes, as it says itself.

use std::sync::LazyLock;

use super::table::{ShaderFile, file};
use super::template::as_it_stands;
use crate::network::Kernel;

/// What a binding behind the output of a kernel holds; the shader calls it so.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Resource {
    /// `weights`: packed weights of the step.
    Weights,
    /// `terms`: units, bias, scale and shift of the step (`weights::Terms`).
    Terms,
    /// `overflow`: the largest magnitude that did not fit the step's output, as the bits of an f32.
    Overflow,
}

/// A kernel's shader. Group 0 is what all of them share (`common/calibration.wgsl`); the bindings of group 1 are the
/// geometry, the inputs, the output, and the resources, in this order.
#[derive(Debug)]
pub struct KernelShader {
    /// Name of the kernel and of the CPU twin; the file is `NAME.wgsl`.
    pub name: &'static str,
    /// Names of the inputs. Those at the end may be missing from a step; the first stands in for them.
    pub inputs: Vec<String>,
    /// Bindings behind the output.
    pub resources: Vec<Resource>,
}

impl KernelShader {
    /// The file.
    pub fn source(&self) -> ShaderFile {
        file(&format!("{}.wgsl", self.name))
    }

    /// Reads the bindings of a kernel off its shader.
    fn read(name: &'static str) -> Self {
        let text = as_it_stands(file(&format!("{name}.wgsl"))).text;
        let bindings = bindings(&text);
        let names: Vec<&str> = bindings.iter().map(String::as_str).collect();
        let Some((["geometry", inputs @ ..], ["output", resources @ ..])) =
            names.iter().position(|name| *name == "output").map(|output| names.split_at(output))
        else {
            panic!(
                "shaders/{name}.wgsl binds {names:?}, not geometry, inputs, output and resources in this order"
            )
        };
        let resource = |resource: &&str| match *resource {
            "weights" => Resource::Weights,
            "terms" => Resource::Terms,
            "overflow" => Resource::Overflow,
            other => panic!("shaders/{name}.wgsl binds {other}, and nobody knows what that holds"),
        };
        let inputs = inputs.iter().map(|&input| input.to_owned()).collect();
        Self { name, inputs, resources: resources.iter().map(resource).collect() }
    }
}

/// Names of the bindings of group 1, which have to be numbered in order.
fn bindings(text: &str) -> Vec<String> {
    let declarations = text.lines().filter_map(|line| line.strip_prefix("@group(1) @binding("));
    let named = |(number, declaration): (usize, &str)| {
        let (at, rest) = declaration.split_once(") var<").expect("a binding is a variable");
        assert_eq!(at, number.to_string(), "bindings are numbered in order: {declaration}");
        let (_, rest) = rest.split_once("> ").expect("a binding has an address space");
        rest.split_once(':').expect("a binding has a type").0.to_owned()
    };
    declarations.enumerate().map(named).collect()
}

/// The shader of a kernel.
pub fn kernel(name: &str) -> &'static KernelShader {
    static SHADERS: LazyLock<Vec<KernelShader>> =
        LazyLock::new(|| Kernel::NAMES.iter().map(|name| KernelShader::read(name)).collect());
    let shader = SHADERS.iter().find(|shader| shader.name == name);
    shader.unwrap_or_else(|| panic!("there is no kernel {name}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shaders_say_what_they_read() {
        let KernelShader { inputs, resources, .. } = kernel("blend");
        assert_eq!((inputs.join(" ").as_str(), &resources[..]), ("weights logs estimate", &[][..]));
        let KernelShader { inputs, resources, .. } = kernel("conv3d");
        assert_eq!(inputs.join(" "), "input added");
        assert_eq!(resources[..], [Resource::Weights, Resource::Terms, Resource::Overflow]);
    }

    #[test]
    #[should_panic(expected = "bindings are numbered in order")]
    fn bindings_are_numbered_in_order() {
        bindings("@group(1) @binding(1) var<uniform> geometry: Geometry;");
    }
}
