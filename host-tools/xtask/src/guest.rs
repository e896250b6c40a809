//! The boot image of the Linux guest, in which a real kernel uses the board's USB.
//!
//! It holds Debian's kernel and busybox, unpacked but not installed, and our own programs as built for the tests, with
//! this machine's C library:
//!
//! ```text
//! target/guest/vmlinux      the kernel, decompressed: QEMU starts it in a third of the time
//! target/guest/base.cpio    busybox, the kernel's modules for USB/IP, CDC and the network, the first script
//! target/guest/initramfs    base.cpio followed by inerter and inerter-guest as they are now, with their libraries
//! target/guest/inerter      the program as it is in initramfs, and inerter-guest beside it
//! target/guest/dfu-util     Debian's updater, and libusb-1.0.so.0 beside it
//! target/guest/packages     which packages the first two and the updater come from
//! ```
//!
//! The packages are fetched once, with the machine's own `apt-get download`, which needs no root. Debian's kernel
//! packages carry their version in their name and old ones vanish, so the name is looked up.

use crate::{
    process, setup, tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result, ensure};
use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// Always the newest kernel; the cloud variant of the kernel has no USB.
const KERNEL: &str = "linux-image-amd64";
/// A shell and its tools in one file.
const BUSYBOX: &str = "busybox-static";
/// A third-party updater for the ROM's update mode, and its library; this machine may have neither.
const UPDATER: [&str; 2] = ["dfu-util", "libusb-1.0-0"];
const UPDATER_FILES: [&str; 2] = ["dfu-util", "libusb-1.0.so.0"];
/// The required modules; their dependencies are added.
const MODULES: &[&str] = &["virtio_pci", "virtio_net", "vhci_hcd", "cdc_acm"];
/// Our programs.
const PROGRAMS: &[(Part, &str)] = &[(Part::Main, "inerter"), (Part::Twin, "inerter-guest")];

/// Programs that fetch and unpack the packages.
const TOOLS: &[&str] = &["apt-get", "apt-cache", "dpkg-deb"];

/// The guest's first script: devices, modules, network, then the test's own commands.
const INIT: &str = "\
#!/bin/busybox sh
/bin/busybox --install -s /bin
export PATH=/bin HOME=/tmp
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mount -t devtmpfs devtmpfs /dev
for module in $(cat /modules/order); do insmod /modules/$module || echo \"init: $module\"; done
ip link set lo up
ip address add 10.0.2.15/24 dev eth0
ip link set eth0 up
for word in $(cat /proc/cmdline); do
    case $word in test=*) inerter-guest serve ${word#test=};; esac
done
reboot -f
";

#[derive(clap::Args, Default)]
pub struct Options {
    /// Fetch kernel and busybox again
    #[arg(long)]
    pub refresh: bool,
}

/// Files made from the packages.
const FETCHED: &[&str] = &["vmlinux", "base.cpio", "packages", UPDATER_FILES[0], UPDATER_FILES[1]];

/// Makes the missing files and prints where they are.
pub fn run(options: &Options) -> Result<()> {
    ensure!(
        cfg!(all(target_os = "linux", target_arch = "x86_64")),
        "the guest runs the programs of this machine under an x86-64 Linux: use such a machine or a container"
    );
    let folder = workspace::folder("guest")?;
    if FETCHED.iter().all(|name| folder.join(name).is_file()) && !options.refresh {
        let packages = tree::text(folder.join("packages"))?.split_whitespace().collect::<Vec<_>>().join(", ");
        println!("guest: {packages} (as fetched before; --refresh fetches anew)");
    } else {
        fetch(&folder)?;
    }
    let mut initramfs = tree::read(folder.join("base.cpio"))?;
    initramfs.extend(programs(&folder)?.finish());
    write(&folder.join("initramfs"), &initramfs)?;
    println!("guest: {} is ready", folder.display());
    setup::ensure(&[setup::Need::System(&setup::GUEST)], false)
}

// ---- the packages

/// Downloads kernel and busybox and keeps what the guest needs.
fn fetch(folder: &Path) -> Result<()> {
    for tool in TOOLS {
        ensure!(
            process::version(tool).is_some(),
            "no {tool} here: the guest is made from Debian's packages. Run `cargo xtask guest` on Debian or in a \
             Debian container and copy vmlinux, base.cpio and packages into {}",
            folder.display()
        );
    }
    let packages = folder.join("fetched");
    tree::remove(&packages)?;
    tree::make(&packages)?;
    let kernel = download(&packages).or_else(|error| {
        println!("guest: {error:#}; the package list may be missing or out of date");
        println!("guest: $ apt-get update");
        process::run(Command::new("apt-get").args(["-qq", "update"])).context("try `sudo apt-get update`")?;
        download(&packages)
    })?;

    let root = packages.join("root");
    let mut names = Vec::new();
    for entry in fs::read_dir(&packages)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "deb") {
            process::run(Command::new("dpkg-deb").arg("-x").arg(&path).arg(&root))?;
            names.push(path.file_stem().unwrap_or_default().to_string_lossy().into_owned());
        }
    }
    names.sort();
    let version = kernel.strip_prefix("linux-image-").context("a kernel package without a version in its name")?;
    let image = fs::read(root.join("boot").join(format!("vmlinuz-{version}"))).context("reading the kernel")?;
    write(&folder.join("vmlinux"), &decompressed_kernel(&image, &packages.join("kernel"))?)?;
    write(&folder.join("base.cpio"), &base(&root, version)?)?;
    for (name, place) in UPDATER_FILES.iter().zip(["usr/bin", "usr/lib/x86_64-linux-gnu"]) {
        let file = root.join(place).join(name);
        let bytes = fs::read(&file).with_context(|| format!("{} is not where it was", file.display()))?;
        write(&folder.join(name), &bytes)?;
    }
    write(&folder.join("packages"), names.join("\n").as_bytes())?;
    tree::remove(packages)
}

/// Puts the packages of the newest kernel, busybox and updater into the folder, and returns the first one's name.
fn download(folder: &Path) -> Result<String> {
    let printed = process::output(Command::new("apt-cache").args(["depends", KERNEL]))?;
    let kernel = depends(&printed)
        .with_context(|| format!("this system has no package {KERNEL}, which is Debian's on amd64"))?;
    println!("guest: downloading {kernel}, {BUSYBOX} and {}, about 72 MB", UPDATER[0]);
    let packages = ["download", &kernel, BUSYBOX];
    process::run(Command::new("apt-get").args(packages).args(UPDATER).current_dir(folder))
        .context("Debian's kernel and busybox could not be fetched")?;
    Ok(kernel)
}

/// The first dependency that `apt-cache depends` lists.
fn depends(printed: &str) -> Option<String> {
    let mut names = printed.lines().filter_map(|line| line.trim().strip_prefix("Depends: "));
    names.find(|name| name.starts_with("linux-image-")).map(str::to_owned)
}

// ---- the kernel

/// The kernel inside a bzImage (Linux, Documentation/arch/x86/boot.rst, fields setup_sects, payload_offset,
/// payload_length), which is written to the file `packed` first.
fn decompressed_kernel(image: &[u8], packed: &Path) -> Result<Vec<u8>> {
    let bytes = payload(image).context("not an x86 kernel image")?;
    let (program, package) = unpacker(bytes).context("the kernel is packed in an unknown format")?;
    // The compressed data are followed by their uncompressed length, which gzip contains itself.
    let length = if program == "gzip" { 0 } else { 4 };
    tree::write(packed, &bytes[..bytes.len().saturating_sub(length)])?;
    let kernel = decompressed(program, package, packed)?;
    ensure!(kernel.starts_with(b"\x7fELF"), "the kernel image does not contain an ELF file");
    Ok(kernel)
}

fn payload(image: &[u8]) -> Option<&[u8]> {
    let number = |at: usize| Some(u32::from_le_bytes(image.get(at..at + 4)?.try_into().ok()?) as usize);
    if image.get(0x202..0x206)? != b"HdrS" {
        return None;
    }
    let sectors = match *image.get(0x1F1)? {
        0 => 4,
        sectors => usize::from(sectors),
    };
    let start = (sectors + 1) * 512 + number(0x248)?;
    image.get(start..start + number(0x24C)?)
}

/// The program that decompresses data with this beginning, for the formats that Linux uses for kernels and modules, and
/// its package.
fn unpacker(packed: &[u8]) -> Option<(&'static str, &'static str)> {
    match packed {
        [0xFD, b'7', b'z', b'X', b'Z', ..] => Some(("xz", "xz-utils")),
        [0x28, 0xB5, 0x2F, 0xFD, ..] => Some(("zstd", "zstd")),
        [0x02, 0x21, 0x4C, 0x18, ..] => Some(("lz4", "lz4")),
        [0x1F, 0x8B, ..] => Some(("gzip", "gzip")),
        _ => None,
    }
}

/// The contents of a file as a decompressor prints them.
fn decompressed(program: &str, package: &str, file: &Path) -> Result<Vec<u8>> {
    let output = Command::new(program)
        .arg("-dc")
        .stdin(fs::File::open(file)?)
        .stderr(Stdio::inherit())
        .output()
        .with_context(|| format!("cannot start {program}; `sudo apt-get install {package}`"))?;
    ensure!(output.status.success(), "{program} failed ({})", output.status);
    Ok(output.stdout)
}

// ---- the first archive

/// Busybox, modules and the first script.
fn base(root: &Path, version: &str) -> Result<Vec<u8>> {
    let mut archive = Archive::default();
    for folder in ["bin", "dev", "modules", "proc", "sys", "tmp"] {
        archive.entry(folder, FOLDER, &[]);
    }
    // Without it the first program has no output.
    archive.entry("dev/console", CONSOLE, &[]);
    archive.file("init", 0o755, INIT.as_bytes());
    let busybox = ["bin/busybox", "usr/bin/busybox"].map(|path| root.join(path));
    let busybox = busybox.iter().find(|path| path.is_file()).context("no busybox in its package")?;
    archive.file("bin/busybox", 0o755, &fs::read(busybox)?);
    archive.entry("bin/sh", LINK, b"busybox");
    let modules = Modules::read(root, version)?;
    let order = modules.order(MODULES)?;
    for name in &order {
        archive.file(&format!("modules/{name}"), 0o644, &modules.load(name)?);
    }
    archive.file("modules/order", 0o644, order.join("\n").as_bytes());
    Ok(archive.finish())
}

/// The modules of a kernel, by their names with underscores.
struct Modules {
    files: BTreeMap<String, PathBuf>,
    builtin: Vec<String>,
}

fn module_name(file: &str) -> String {
    file.split('.').next().unwrap_or(file).replace('-', "_")
}

impl Modules {
    fn read(root: &Path, version: &str) -> Result<Self> {
        let folders = ["lib/modules", "usr/lib/modules"].map(|path| root.join(path).join(version));
        let folder = folders.iter().find(|path| path.is_dir()).context("the kernel's package has no modules")?;
        let name = |path: &Path| module_name(&path.file_name().unwrap_or_default().to_string_lossy());
        let files = tree::files(folder.join("kernel"))?.into_iter().map(|path| (name(&path), path)).collect();
        let list = fs::read_to_string(folder.join("modules.builtin")).unwrap_or_default();
        let builtin = list.lines().filter_map(|line| line.rsplit('/').next()).map(module_name).collect();
        Ok(Self { files, builtin })
    }

    /// The module's bytes, unpacked.
    fn load(&self, name: &str) -> Result<Vec<u8>> {
        let path = self.files.get(name).with_context(|| format!("the kernel has no module {name}"))?;
        let bytes = tree::read(path)?;
        match unpacker(&bytes) {
            Some((program, package)) => decompressed(program, package, path),
            None => Ok(bytes),
        }
    }

    /// These modules with all their dependencies, each after those it needs.
    fn order(&self, wanted: &[&str]) -> Result<Vec<String>> {
        let (mut visited, mut order) = (self.builtin.iter().cloned().collect(), Vec::new());
        for name in wanted {
            self.visit(name, &mut visited, &mut order)?;
        }
        Ok(order)
    }

    /// Adds a module after those it needs, unless it was visited.
    fn visit(&self, name: &str, visited: &mut BTreeSet<String>, order: &mut Vec<String>) -> Result<()> {
        if visited.insert(name.to_owned()) {
            for needed in needs(&self.load(name)?) {
                self.visit(&needed, visited, order)?;
            }
            order.push(name.to_owned());
        }
        Ok(())
    }
}

/// Names of the modules that a module's `.modinfo` says it depends on.
fn needs(module: &[u8]) -> Vec<String> {
    const FIELD: &[u8] = b"\0depends=";
    let Some(at) = module.windows(FIELD.len()).position(|window| window == FIELD) else { return Vec::new() };
    let list = module[at + FIELD.len()..].split(|byte| *byte == 0).next().unwrap_or_default();
    let list = String::from_utf8_lossy(list);
    list.split(',').filter(|name| !name.is_empty()).map(module_name).collect()
}

// ---- our programs

/// The programs without symbols, and the libraries that they need, at the paths where this machine has them.
fn programs(folder: &Path) -> Result<Archive> {
    for (part, name) in PROGRAMS {
        process::run(Command::new("strip").arg("-o").args([folder.join(name), workspace::tested(*part, name)?]))?;
    }
    let mut files = BTreeMap::new();
    for name in PROGRAMS.iter().map(|(_, name)| *name).chain([UPDATER_FILES[0]]) {
        let program = folder.join(name);
        let mut ldd = Command::new("ldd");
        for needed in libraries(&process::output(ldd.env("LD_LIBRARY_PATH", folder).arg(&program))?)? {
            // One of the updater's libraries is fetched; all others are this machine's, at the same paths.
            let place = match Path::new(needed).starts_with(folder) {
                true => format!("lib/x86_64-linux-gnu/{}", UPDATER_FILES[1]),
                false => needed.trim_start_matches('/').to_owned(),
            };
            files.insert(place, PathBuf::from(needed));
        }
        files.insert(format!("bin/{name}"), program);
    }
    let library = folder.join(UPDATER_FILES[1]);
    ensure!(files.values().any(|path| *path == library), "dfu-util needs another libusb than {}", UPDATER_FILES[1]);
    let mut archive = Archive::default();
    let folders: BTreeSet<&Path> = files
        .keys()
        .flat_map(|name| Path::new(name).ancestors().skip(1))
        .filter(|path| *path != Path::new(""))
        .collect();
    for folder in folders {
        archive.entry(&folder.to_string_lossy(), FOLDER, &[]);
    }
    for (name, path) in &files {
        archive.file(name, 0o755, &tree::read(path)?);
    }
    Ok(archive)
}

/// The libraries in what `ldd` prints: `libm.so.6 => /lib/x86_64-linux-gnu/libm.so.6 (0x0000)`, or a path alone; the
/// kernel's own has none.
fn libraries(printed: &str) -> Result<Vec<&str>> {
    let mut paths = Vec::new();
    for line in printed.lines() {
        ensure!(!line.contains("not found"), "ldd: {}", line.trim());
        let path = line.split_once("=>").map_or(line, |(_, path)| path).split_whitespace().next().unwrap_or_default();
        paths.extend(path.starts_with('/').then_some(path));
    }
    Ok(paths)
}

// ---- archives

/// Modes of the entries that are no files.
const FOLDER: u32 = 0o040_755;
const LINK: u32 = 0o120_777;
const CONSOLE: u32 = 0o020_600;

/// An archive as the kernel unpacks it (Linux, Documentation/driver-api/early-userspace/buffer-format.rst: newc).
#[derive(Default)]
struct Archive {
    bytes: Vec<u8>,
    entries: u32,
}

impl Archive {
    fn entry(&mut self, name: &str, mode: u32, content: &[u8]) {
        self.entries += 1;
        let [major, minor] = if mode == CONSOLE { [5, 1] } else { [0, 0] };
        let name_length = name.len() as u32 + 1;
        let fields = [self.entries, mode, 0, 0, 1, 0, content.len() as u32, 0, 0, major, minor, name_length, 0];
        self.bytes.extend(b"070701");
        for field in fields {
            self.bytes.extend(format!("{field:08X}").bytes());
        }
        self.bytes.extend(name.bytes());
        self.bytes.push(0);
        self.pad();
        self.bytes.extend_from_slice(content);
        self.pad();
    }

    fn pad(&mut self) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }

    fn file(&mut self, name: &str, permissions: u32, content: &[u8]) {
        self.entry(name, 0o100_000 | permissions, content);
    }

    fn finish(mut self) -> Vec<u8> {
        self.entry("TRAILER!!!", 0, &[]);
        self.bytes
    }
}

/// Writes a file whole or not at all.
fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    let part = path.with_extension("part");
    fs::write(&part, bytes)
        .and_then(|()| fs::rename(&part, path))
        .with_context(|| format!("writing {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::Fixture;

    #[test]
    fn the_newest_kernel_is_the_one_that_the_package_depends_on() {
        let printed = "linux-image-amd64\n  Depends: linux-image-6.1.0-56-amd64\n  Suggests: something\n";
        assert_eq!(depends(printed).as_deref(), Some("linux-image-6.1.0-56-amd64"));
        assert_eq!(depends("N: Unable to locate package\n"), None);
    }

    #[test]
    fn what_a_module_needs_stands_in_it() {
        let module = b"\x7fELF...license=GPL\0depends=usbcore,usb-common\0name=cdc_acm\0";
        assert_eq!(needs(module), ["usbcore", "usb_common"]);
        assert_eq!(needs(b"\0depends=\0name=usb_common\0"), Vec::<String>::new());
        assert_eq!(needs(b"no module"), Vec::<String>::new());
    }

    #[test]
    fn libraries_are_found_where_ldd_says() {
        let printed = "\tlinux-vdso.so.1 (0x00007ffc)\n\tlibm.so.6 => /lib/x86_64-linux-gnu/libm.so.6 (0x00007f0b)\n\t/lib64/ld-linux-x86-64.so.2 (0x00007f)\n";
        assert_eq!(libraries(printed).unwrap(), ["/lib/x86_64-linux-gnu/libm.so.6", "/lib64/ld-linux-x86-64.so.2"]);
        assert_eq!(libraries("\tstatically linked\n").unwrap(), Vec::<&str>::new());
        assert!(libraries("\tlibx.so => not found\n").is_err());
    }

    #[test]
    fn modules_come_behind_what_they_need() {
        let fixture = Fixture::new(&[
            ("lib/modules/1.0/kernel/drivers/cdc-acm.ko", "\0depends=usbcore\0"),
            ("lib/modules/1.0/kernel/drivers/usbcore.ko", "\0depends=usb-common,crc\0"),
            ("lib/modules/1.0/kernel/drivers/usb-common.ko", "\0depends=\0"),
            ("lib/modules/1.0/kernel/drivers/one.ko", "\0depends=other\0"),
            ("lib/modules/1.0/kernel/drivers/other.ko", "\0depends=one\0"),
            ("lib/modules/1.0/modules.builtin", "kernel/lib/crc.ko\n"),
        ]);
        let modules = Modules::read(&fixture.0, "1.0").expect("modules");
        assert_eq!(modules.order(&["cdc_acm", "usb_common"]).expect("all there"), ["usb_common", "usbcore", "cdc_acm"]);
        assert_eq!(modules.order(&["one"]).expect("a circle"), ["other", "one"]);
        let missing = modules.order(&["vhci_hcd"]).expect_err("not there");
        assert!(missing.to_string().contains("vhci_hcd"));
    }

    #[test]
    fn the_payload_of_a_kernel_image_is_found_where_its_header_says() {
        let mut image = vec![0; 2048];
        image[0x1F1] = 1;
        image[0x202..0x206].copy_from_slice(b"HdrS");
        image[0x248] = 16;
        image[0x24C] = 7;
        image[1024 + 16..][..7].copy_from_slice(b"payload");
        assert_eq!(payload(&image), Some(b"payload".as_slice()));
        image[0x24D] = 0xFF;
        assert_eq!(payload(&image), None);
        assert_eq!(payload(b"short"), None);
    }

    #[test]
    fn an_archive_is_read_by_offsets_in_steps_of_four() {
        let mut archive = Archive::default();
        archive.file("a", 0o644, b"hello");
        let bytes = archive.finish();
        assert_eq!(bytes[..14], *b"07070100000001");
        assert_eq!(bytes[110..112], *b"a\0");
        assert_eq!(bytes[112..117], *b"hello");
        assert_eq!(bytes[120..126], *b"070701");
        assert_eq!(bytes.len() % 4, 0);
        assert!(bytes.ends_with(b"TRAILER!!!\0\0\0\0"));
    }
}
