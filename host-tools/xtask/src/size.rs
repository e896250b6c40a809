//! The image's use of flash, static RAM and stack.

use crate::{
    firmware::{self, Image},
    icount, process,
    table::{Options, Row, Table, number},
    tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result};
use object::{Object, ObjectSection, ObjectSymbol, SectionFlags, SectionKind, SymbolKind, elf};
use serde_json::Value;
use std::{path::Path, process::Command};

/// It is a matter of chance whether an interrupt occurs during the deepest call.
const STACK_TOLERANCE: f64 = 0.15;

/// Start of RAM; below it is flash, except for CCM SRAM (RM0440, 2.2.2).
const RAM: u64 = 0x2000_0000;
const CCM: std::ops::Range<u64> = 0x1000_0000..0x1000_8000;

/// Sizes by section and by crate, in bytes.
#[derive(Default)]
struct Sizes {
    /// Code and vector table.
    text: u64,
    rodata: u64,
    /// Variables with a value at the start: in flash and in RAM.
    data: u64,
    /// Variables without one.
    bss: u64,
    /// Part of `text` in functions of `inerter-core`; inlined code counts where it was inlined.
    core_text: u64,
}

/// Goal for the load: a quarter of 168 MHz, at one instruction per cycle.
const LOAD_GOAL: f64 = 42e6;
/// Goal for the load in cycles, pessimistic, in per cent.
const CYCLES_GOAL: f64 = 35.0;
/// The load depends slightly on the motion's noise.
const LOAD_TOLERANCE: f64 = 0.05;

/// Goals for the image that ships, in bytes; RAM includes CCM SRAM. The image has the first of the chip's two flash
/// banks, 256 KB.
const FLASH_GOAL: f64 = 192.0 * 1024.0;
const RAM_GOAL: f64 = 56.0 * 1024.0;

/// Compares with the committed table, or writes it.
pub fn run(options: &Options) -> Result<()> {
    let board = firmware::build(Image::BOARD)?;
    let mut rows = rows("board", &measure(&board)?);
    rows[0].goal = Some(FLASH_GOAL);
    rows[5].goal = Some(RAM_GOAL);
    let figures = twin(&board)?;
    let (without, stack) = (rows[5].value, number(&figures, "stack_bytes", &figures)?);
    for (name, bytes) in [("board, RAM: worst stack", stack), ("board, RAM with the worst stack", without + stack)] {
        rows.push(Row::new(name, bytes, "bytes").within(STACK_TOLERANCE));
    }
    rows.extend(loads(&figures)?);
    let qemu = firmware::build(Image::QEMU)?;
    rows.extend(self::rows("qemu", &measure(&qemu)?));
    let (_, state_bytes) = icount::measure(&qemu)?;
    rows.push(Row::new("RAM: state of the estimator", state_bytes, "bytes"));
    let table = Table {
        name: "size",
        title: "Size and load of the images",
        about: "The board's image is measured as it ships (`cargo build --release` in firmware/stm32g474), QEMU's in\n\
                the profile `firmware`. Flash is code, constants and start values; RAM is start values and zeroed\n\
                variables. The estimator's code is that of the functions of `inerter-core` that were not inlined\n\
                elsewhere.\n\n\
                The twin runs the board's image with every stream on. The worst stack is the part of the painted\n\
                stack that was overwritten during this run. The load is the number of instructions per second in the\n\
                same run. *optimistic* and *pessimistic* are bounds of the cycles that these instructions take on\n\
                the chip, of 168 million cycles per second (docs/ARCHITECTURE.md, The twin).\n\n\
                The goal of 56 KB applies to RAM without stack. A separate row without a goal gives the RAM\n\
                including the worst stack, of the 96 KB for which the image is linked."
            .into(),
        rows,
        repeats: true,
    };
    table.settle(options)
}

fn rows(image: &str, sizes: &Sizes) -> Vec<Row> {
    let row = |name: &str, value: u64| Row::new(format!("{image}, {name}"), value as f64, "bytes");
    vec![
        row("flash", sizes.text + sizes.rodata + sizes.data),
        row("flash: code", sizes.text),
        row("flash: constants", sizes.rodata),
        row("flash: start values", sizes.data),
        row("flash: code of the estimator", sizes.core_text),
        row("RAM without stack", sizes.data + sizes.bss),
    ]
}

/// Instructions and bounds of the load at each rate.
fn loads(figures: &Value) -> Result<Vec<Row>> {
    let loads = figures["loads"].as_array().with_context(|| format!("no list `loads` in {figures}"))?;
    let mut rows = Vec::new();
    for load in loads {
        let figure = |name: &str| number(load, name, load);
        let with = load["with"].as_str().with_context(|| format!("no text `with` in {load}"))?;
        // The digital front end delivers single samples: its load is reported, without a goal.
        let digital = with.starts_with("ADS131M04");
        let with = if with.is_empty() { String::new() } else { format!(" ({with})") };
        let name = format!("board, load at {} kHz{with}", figure("rate_hz")?.round() / 1e3);
        let row = Row::new(&name, figure("instructions_per_s")?, "instructions/s");
        rows.push(row.within(LOAD_TOLERANCE).at_most(LOAD_GOAL));
        let percent = |bound: &str, fraction: f64| {
            let row = Row::new(format!("{name}, {bound}"), (fraction * 1e3).round() / 10.0, "% of the cycles");
            row.within(LOAD_TOLERANCE)
        };
        rows.push(percent("optimistic", figure("least")?));
        let goal = (!digital).then_some(CYCLES_GOAL);
        rows.push(Row { goal, ..percent("pessimistic", figure("most")?) });
    }
    Ok(rows)
}

/// The twin's measurements of the board's image with every stream on.
fn twin(image: &Path) -> Result<Value> {
    let program = workspace::tested(Part::Twin, "figures")?;
    let printed = process::output(Command::new(program).env(Image::BOARD.variable, image))?;
    serde_json::from_str(printed.trim()).with_context(|| format!("no JSON: {printed}"))
}

/// Reads the sizes out of an image.
fn measure(image: &Path) -> Result<Sizes> {
    sizes(&tree::read(image)?).with_context(|| format!("{} is not an image", image.display()))
}

fn sizes(bytes: &[u8]) -> Result<Sizes> {
    let file = object::File::parse(bytes)?;
    let mut sizes = Sizes::default();
    for section in file.sections() {
        let SectionFlags::Elf { sh_flags, .. } = section.flags() else { continue };
        if !sh_flags.contains(elf::SHF_ALLOC) {
            continue;
        }
        let size = section.size();
        if section.address() >= RAM || CCM.contains(&section.address()) {
            if section.kind() == SectionKind::UninitializedData { sizes.bss += size } else { sizes.data += size }
        } else if sh_flags.contains(elf::SHF_EXECINSTR) || section.name() == Ok(".vector_table") {
            sizes.text += size;
        } else {
            sizes.rodata += size;
        }
    }
    for symbol in file.symbols().filter(|symbol| symbol.kind() == SymbolKind::Text) {
        let name = format!("{:#}", rustc_demangle::demangle(symbol.name().unwrap_or_default()));
        if of_core(&name) {
            sizes.core_text += symbol.size();
        }
    }
    Ok(sizes)
}

/// Whether this demangled name is a function of the estimator: `inerter_core::..` or `<inerter_core::Active as ..>`.
pub fn of_core(name: &str) -> bool {
    name.trim_start_matches(['<', '&', '(']).starts_with("inerter_core::")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn functions_of_the_estimator_are_told_apart() {
        assert!(of_core("inerter_core::rls::update"));
        assert!(of_core("<inerter_core::Active as core::fmt::Debug>::fmt"));
        assert!(!of_core("inerter_app::run::<inerter_core::Active>"));
    }

    #[test]
    fn what_is_no_image_is_refused() {
        assert!(sizes(b"not an image").is_err());
        assert!(sizes(&[]).is_err());
    }

    #[test]
    fn each_rate_has_three_rows() {
        let figures = serde_json::json!({
            "loads": [
                {"with": "", "rate_hz": 4000, "instructions_per_s": 5.0, "least": 0.12344, "most": 0.4},
                {"with": "ADS131M04", "rate_hz": 3906.25, "instructions_per_s": 6.0, "least": 0.1, "most": 0.2}
            ]
        });
        let rows = loads(&figures).unwrap();
        let said: Vec<_> = rows.iter().map(|row| (row.name.as_str(), row.value, row.goal)).collect();
        let expected = [
            ("board, load at 4 kHz", 5.0, Some(LOAD_GOAL)),
            ("board, load at 4 kHz, optimistic", 12.3, None),
            ("board, load at 4 kHz, pessimistic", 40.0, Some(CYCLES_GOAL)),
            ("board, load at 3.906 kHz (ADS131M04)", 6.0, Some(LOAD_GOAL)),
            ("board, load at 3.906 kHz (ADS131M04), optimistic", 10.0, None),
            ("board, load at 3.906 kHz (ADS131M04), pessimistic", 20.0, None),
        ];
        assert_eq!(said, expected);
        assert!(loads(&serde_json::json!({"loads": [{"with": "", "rate_hz": 1}]})).is_err());
    }

    #[test]
    fn start_values_count_in_flash_and_ram() {
        let sizes = Sizes { text: 1, rodata: 2, data: 4, bss: 8, core_text: 1 };
        let rows = rows("board", &sizes);
        assert_eq!((rows[0].name.as_str(), rows[0].value), ("board, flash", 7.0));
        assert_eq!((rows[5].name.as_str(), rows[5].value), ("board, RAM without stack", 12.0));
    }
}
