//! Nothing on standard error that others say before us.

/// Goes on as a process in which Mesa's layer that sorts devices is off, where it would only complain.
///
/// The Vulkan loader puts that layer (`VK_LAYER_MESA_device_select`) before every driver. It asks Wayland which device
/// draws the desktop, because wgpu enables the surfaces of all window systems, window or not; without a folder for
/// sockets, libwayland prints "error: XDG_RUNTIME_DIR is invalid or not set in the environment", once each time the
/// adapters are listed. The layer is asked by a variable to stay away. A process cannot safely change its own
/// variables, but it can become another one. Devices are not sorted by it here: the program ranks them itself.
#[cfg(target_os = "linux")]
pub fn without_wayland() {
    use std::env;
    use std::os::unix::process::CommandExt;
    use std::process::Command;

    const OFF: &str = "NODEVICE_SELECT";
    let asked =
        ["XDG_RUNTIME_DIR", OFF, "MESA_VK_DEVICE_SELECT"].iter().any(|name| env::var_os(name).is_some());
    let Ok(program) = env::current_exe() else { return };
    if !asked {
        let mut arguments = env::args_os();
        let mut same = Command::new(program);
        same.arg0(arguments.next().unwrap_or_default()).args(arguments).env(OFF, "1");
        // It only returns where that cannot be done: then there are a few lines more.
        let _ = same.exec();
    }
}

/// Others do not speak there.
#[cfg(not(target_os = "linux"))]
pub fn without_wayland() {}
