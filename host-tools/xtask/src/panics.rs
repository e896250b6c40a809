//! The shipping image cannot panic inside the estimator, and cannot allocate.
//!
//! Three proofs on the image itself, because the optimised code is what runs:
//! - No chain of branches leads from a function of `inerter-core` to the panic handler. Every direct Thumb-2 branch is
//!   followed. To save space, a compiler may keep the address of an often-called function in a register: so every
//!   function whose address is among the constants of another is followed too, and calls through a register without
//!   such a constant are rejected. The serialisers derived for the estimator's records are excluded: they call the
//!   frame writer.
//! - The image contains no path of the estimator's source files: each panic that could still happen, even in code that
//!   was inlined elsewhere, carries the path of its file.
//! - The image contains no symbol of an allocator.
//!
//! Source: ARMv7-M Architecture Reference Manual (DDI 0403E), A7.7.12 (B), A7.7.18 (BL), A7.7.19 (BLX).

use crate::{
    firmware::{self, Image},
    size, tree,
};
use anyhow::{Context, Result, ensure};
use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};
use std::collections::{BTreeMap, HashMap, VecDeque};

/// Path of the estimator's sources as a panic contains it.
const SOURCES: &[u8] = b"firmware/core/src/";
/// The function in which every panic ends.
const HANDLER: &str = "rust_begin_unwind";
/// Parts of the names of an allocator's functions.
const ALLOCATORS: &[&str] = &["__rust_alloc", "__rust_realloc", "__rg_alloc", "__rdl_alloc"];

/// A function of the image.
struct Function {
    name: String,
    code: Vec<u16>,
    address: u64,
    /// Addresses where constants begin (true) and end (false) within the code.
    constants: BTreeMap<u64, bool>,
}

/// Where a function may branch to.
#[derive(Default)]
struct Branches {
    targets: Vec<u64>,
    /// Words among the constants that could be addresses of functions.
    addresses: Vec<u64>,
    /// Calls and jumps through a register.
    indirect: usize,
}

/// Builds the shipping image and checks it.
pub fn run() -> Result<()> {
    let path = firmware::build(Image::BOARD)?;
    let image = Program::read(&tree::read(&path)?).with_context(|| format!("{} is not an image", path.display()))?;
    let faults = image.faults();
    for fault in &faults {
        eprintln!("  {fault}");
    }
    ensure!(faults.is_empty(), "the shipping image could panic in the estimator or allocate (see above)");
    println!(
        "panics: none can be reached from the {} functions of the estimator in the image, and nothing allocates",
        image.estimator().count()
    );
    Ok(())
}

/// The contents of an image that are checked.
struct Program {
    functions: Vec<Function>,
    /// Function by its address.
    at: HashMap<u64, usize>,
    /// Files of the estimator named in panics, and allocators.
    faults: Vec<String>,
}

impl Program {
    fn read(bytes: &[u8]) -> Result<Self> {
        let file = object::File::parse(bytes)?;
        let mut marks = BTreeMap::new();
        let mut symbols = Vec::new();
        let sections = file.sections().filter(|section| section.address() != 0);
        let named = sections.flat_map(|section| paths(section.data().unwrap_or_default()));
        let mut faults: Vec<_> = named.map(|name| format!("a panic names {name}")).collect();
        for symbol in file.symbols() {
            let Ok(name) = symbol.name() else { continue };
            // Mapping symbols: code and constants in the same section (ELF for the Arm Architecture, 5.5.5).
            if name.starts_with("$d") || name.starts_with("$t") {
                marks.insert(symbol.address(), name.starts_with("$d"));
            } else if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
                let name = format!("{:#}", rustc_demangle::demangle(name));
                if ALLOCATORS.iter().any(|part| name.contains(part)) {
                    faults.push(format!("an allocator: {name}"));
                }
                symbols.push((symbol.address() & !1, symbol.size(), name));
            }
        }
        let mut functions = Vec::new();
        let mut at = HashMap::new();
        for (address, size, name) in symbols {
            let data = file.sections().find_map(|section| section.data_range(address, size).ok().flatten());
            let Some(data) = data else { continue };
            let (halves, _) = data.as_chunks::<2>();
            let code = halves.iter().map(|bytes| u16::from_le_bytes(*bytes)).collect();
            let mut constants: BTreeMap<_, _> = marks.range(address..address + size).map(|(k, v)| (*k, *v)).collect();
            constants.entry(address).or_insert(false);
            at.insert(address, functions.len());
            functions.push(Function { name, code, address, constants });
        }
        Ok(Self { functions, at, faults })
    }

    fn estimator(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.functions.len()).filter(|&place| of_estimator(&self.functions[place].name))
    }

    fn faults(&self) -> Vec<String> {
        let mut faults = self.faults.clone();
        if self.estimator().next().is_none() {
            faults.push("no function of inerter-core has a symbol: nothing was checked".into());
        }
        if !self.functions.iter().any(|function| function.name.contains(HANDLER)) {
            faults.push(format!("no {HANDLER} has a symbol: nothing was checked"));
        }
        for start in self.estimator() {
            let function = &self.functions[start];
            let branches = function.branches();
            if branches.indirect > 0 && !branches.addresses.iter().any(|address| self.at.contains_key(address)) {
                faults.push(format!(
                    "{}: {} calls through a register, to unknown targets",
                    function.name, branches.indirect
                ));
            }
            if let Some(way) = self.way_to_panic(start) {
                faults.push(way.join(" -> "));
            }
        }
        faults
    }

    /// The shortest chain of functions from here to the panic handler.
    fn way_to_panic(&self, start: usize) -> Option<Vec<&str>> {
        let mut before: HashMap<usize, usize> = HashMap::new();
        let mut line = VecDeque::from([start]);
        while let Some(place) = line.pop_front() {
            let function = &self.functions[place];
            if function.name.contains(HANDLER) {
                let mut way = vec![function.name.as_str()];
                let mut at = place;
                while at != start {
                    at = before[&at];
                    way.push(&self.functions[at].name);
                }
                way.reverse();
                return Some(way);
            }
            let Branches { targets, addresses, .. } = function.branches();
            for next in targets.iter().chain(&addresses).filter_map(|target| self.at.get(target)) {
                if *next != start && !before.contains_key(next) {
                    before.insert(*next, place);
                    line.push_back(*next);
                }
            }
        }
        None
    }
}

impl Function {
    fn branches(&self) -> Branches {
        let mut found = Branches::default();
        let end = self.address + 2 * self.code.len() as u64;
        let mut place = 0;
        while let Some(&first) = self.code.get(place) {
            let address = self.address + 2 * place as u64;
            if self.constants.range(..=address).next_back().is_some_and(|(_, constant)| *constant) {
                if let (0, Some(&high)) = (address % 4, self.code.get(place + 1)) {
                    let word = u64::from(first) | u64::from(high) << 16;
                    // The lowest bit marks Thumb code.
                    if word & 1 == 1 {
                        found.addresses.push(word - 1);
                    }
                }
                place += 1;
                continue;
            }
            let wide = first >> 11 >= 0b11101;
            let second = if wide { self.code.get(place + 1).copied().unwrap_or_default() } else { 0 };
            let target = if wide { wide_target(first, second) } else { narrow_target(first) };
            if let Some(offset) = target {
                let target = address.wrapping_add(4).wrapping_add_signed(offset);
                if !(self.address..end).contains(&target) {
                    found.targets.push(target);
                }
            }
            // BLX Rm, and BX Rm except for the return, BX LR.
            if first & 0xFF87 == 0x4780 || (first & 0xFF87 == 0x4700 && first != 0x4770) {
                found.indirect += 1;
            }
            place += 1 + usize::from(wide);
        }
        found
    }
}

/// Whether this is a function of the estimator and not a derived serialiser.
fn of_estimator(name: &str) -> bool {
    size::of_core(name) && !name.contains("serde_core::")
}

/// Offset of B (encodings T1 and T2) from the program counter.
fn narrow_target(code: u16) -> Option<i64> {
    match code >> 12 {
        // 0b1110 and 0b1111 are UDF and SVC.
        0b1101 if code >> 8 & 0xF < 0xE => Some(i64::from(code as u8 as i8) * 2),
        0b1110 if code >> 11 == 0b11100 => Some(i64::from(((code << 5) as i16) >> 4)),
        _ => None,
    }
}

/// Offset of B (encodings T3 and T4) and BL from the program counter.
fn wide_target(first: u16, second: u16) -> Option<i64> {
    if first >> 11 != 0b11110 || second & 0x8000 == 0 {
        return None;
    }
    let bit = |word: u16, place: u32| i64::from(word >> place & 1);
    let sign = bit(first, 10);
    let (low, j1, j2) = (i64::from(second & 0x7FF), bit(second, 13), bit(second, 11));
    match (second >> 14 & 1, second >> 12 & 1) {
        // BL and B.W: 24 bits; J1 and J2 encode two more, relative to the sign.
        (_, 1) => {
            let (i1, i2) = (1 - (j1 ^ sign), 1 - (j2 ^ sign));
            Some((-sign << 24) | i1 << 23 | i2 << 22 | i64::from(first & 0x3FF) << 12 | low << 1)
        }
        // Conditional B.W; conditions from 0b1110 on are other instructions.
        (0, 0) if first >> 6 & 0xF < 0xE => {
            Some((-sign << 20) | j2 << 19 | j1 << 18 | i64::from(first & 0x3F) << 12 | low << 1)
        }
        _ => None,
    }
}

/// Paths of the estimator's files within constants.
fn paths(data: &[u8]) -> Vec<String> {
    let mut found: Vec<String> = data
        .windows(SOURCES.len())
        .enumerate()
        .filter(|(_, window)| *window == SOURCES)
        .map(|(at, _)| {
            let path = data[at..].iter().take_while(|byte| byte.is_ascii_graphic()).take(64);
            path.map(|byte| char::from(*byte)).collect()
        })
        .collect();
    found.dedup();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn function(name: &str, address: u64, code: &[u16]) -> Function {
        Function { name: name.into(), code: code.into(), address, constants: BTreeMap::from([(address, false)]) }
    }

    fn handler() -> Function {
        function("__rustc::rust_begin_unwind", 0x120, &[0xE7FE])
    }

    fn program(functions: Vec<Function>) -> Program {
        let at = functions.iter().enumerate().map(|(place, function)| (function.address, place)).collect();
        Program { functions, at, faults: Vec::new() }
    }

    // Encodings as an assembler prints them.
    #[test]
    fn branches_are_decoded() {
        assert_eq!(wide_target(0xF000, 0xF800), Some(0), "bl .+4");
        assert_eq!(wide_target(0xF7FF, 0xFFFE), Some(-4), "bl .");
        assert_eq!(wide_target(0xF000, 0xB800), Some(0), "b.w .+4");
        assert_eq!(wide_target(0xF43F, 0xAFFE), Some(-4), "beq.w .");
        assert_eq!(wide_target(0xF3BF, 0x8F4F), None, "dsb");
        assert_eq!(wide_target(0xF8DF, 0xF000), None, "ldr.w pc");
        assert_eq!(narrow_target(0xE7FE), Some(-4), "b .");
        assert_eq!(narrow_target(0xD0FE), Some(-4), "beq .");
        assert_eq!(narrow_target(0xDE00), None, "udf");
        assert_eq!(narrow_target(0x4770), None, "bx lr");
    }

    #[test]
    fn a_way_to_the_handler_is_found_and_told() {
        // bl 0x110; bx lr / bl 0x120 / handler
        let faults = |step: &[u16]| {
            let step = function("inerter_core::step", 0x100, step);
            program(vec![step, function("helper", 0x110, &[0xF000, 0xF806]), handler()]).faults()
        };
        assert_eq!(faults(&[0xF000, 0xF806, 0x4770]), ["inerter_core::step -> helper -> __rustc::rust_begin_unwind"]);
        assert!(faults(&[0x4770]).is_empty());
    }

    #[test]
    fn a_call_through_a_register_is_refused_but_not_a_constant() {
        let mut step = function("inerter_core::step", 0x100, &[0x4770, 0x4798]);
        assert_eq!(step.branches().indirect, 1, "blx r3");
        step.constants.insert(0x102, true);
        assert_eq!(step.branches().indirect, 0);
    }

    #[test]
    fn an_address_among_the_constants_is_followed() {
        // blx r3; bx lr; .word 0x111 / nothing / handler
        let faults = |address: u16| {
            let mut step = function("inerter_core::step", 0x100, &[0x4798, 0x4770, address, 0]);
            step.constants.insert(0x104, true);
            program(vec![step, function("harmless", 0x110, &[0x4770]), handler()]).faults()
        };
        assert!(faults(0x111).is_empty());
        assert_eq!(faults(0x121), ["inerter_core::step -> __rustc::rust_begin_unwind"]);
        assert_eq!(faults(0x131), ["inerter_core::step: 1 calls through a register, to unknown targets"]);
    }

    #[test]
    fn serialisers_are_the_frame_writers() {
        assert!(of_estimator("inerter_core::report::<impl inerter_core::active::Active>::estimate"));
        assert!(!of_estimator(
            "inerter_core::estimate::_::<impl serde_core::ser::Serialize for inerter_core::Bank>::serialize"
        ));
        assert!(!of_estimator("inerter_app::run::run"));
    }

    #[test]
    fn nothing_to_check_is_a_fault() {
        assert_eq!(program(vec![]).faults().len(), 2);
        assert!(Program::read(b"no image").is_err());
    }

    #[test]
    fn a_named_file_is_found() {
        assert_eq!(paths(b"xx\0firmware/core/src/rls.rs\0yy"), ["firmware/core/src/rls.rs"]);
        assert!(paths(b"firmware/app/src/app.rs").is_empty());
    }
}
