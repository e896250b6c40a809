//! Register descriptions of the chip from `stm32-metapac`, for the tests of the models and for `tests/registers.rs`.

#![allow(dead_code, reason = "each test program uses its part")]

use std::collections::BTreeMap;
use stm32_metapac::metadata::ir::{Array, BitOffset, Block, BlockItem, BlockItemInner, Field, IR};
use stm32_metapac::metadata::{METADATA, Peripheral};

/// A register, with the fields of all its views merged.
#[derive(Clone, Debug)]
pub struct Register {
    /// Names of the peripheral and the register.
    pub name: String,
    /// Bits that belong to any field.
    pub fields: u32,
}

/// A peripheral.
pub fn peripheral(name: &str) -> &'static Peripheral {
    METADATA.peripherals.iter().find(|one| one.name == name).unwrap_or_else(|| panic!("metapac has no {name}"))
}

/// All registers, by address.
pub fn registers() -> BTreeMap<u32, Register> {
    let mut found = BTreeMap::new();
    for peripheral in METADATA.peripherals {
        if let Some(registers) = &peripheral.registers {
            walk(registers.ir, registers.block, peripheral.address as u32, peripheral.name, &mut found);
        }
    }
    found
}

/// Address of a peripheral's register, and the bits of one of its fields; for an array of fields, those of the first.
pub fn field(of: &str, register: &str, name: &str) -> (u32, u32) {
    let peripheral = peripheral(of);
    let registers = peripheral.registers.as_ref().expect("metapac describes its registers");
    let (item, fieldset) =
        item(registers.ir, registers.block, register).unwrap_or_else(|| panic!("metapac has no {of}.{register}"));
    let field = all_fields(registers.ir, fieldset).into_iter().find(|field| is_named(field.name, name));
    let field = field.unwrap_or_else(|| panic!("metapac has no {of}.{register}.{name}"));
    let first = offsets(&field.array)[0];
    (peripheral.address as u32 + item.byte_offset, field_mask(&field.bit_offset, field.bit_size) << first)
}

/// Asserts that constants of a model match metapac's fields.
///
/// # Panics
/// If a constant differs.
pub fn fields_agree<B: Into<u32> + Copy>(of: &str, register: &str, constants: &[(&str, B)]) {
    for (name, bits) in constants {
        assert_eq!((*bits).into(), field(of, register, name).1, "{of}.{register}.{name}");
    }
}

/// Compares names. The lists of peripherals and of registers use different case and underscores.
pub fn is_named(one: &str, other: &str) -> bool {
    let letters = |name: &str| name.replace('_', "").to_ascii_lowercase();
    letters(one) == letters(other)
}

fn block(ir: &IR, name: &str) -> &'static Block {
    ir.blocks.iter().find(|one| is_named(one.name, name)).expect("metapac describes its blocks")
}

/// A register of a block, or of a block nested in it.
fn item(ir: &'static IR, name: &str, register: &str) -> Option<(&'static BlockItem, &'static str)> {
    let block = block(ir, name);
    let own = block.items.iter().find_map(|one| match &one.inner {
        BlockItemInner::Register(inner) if is_named(one.name, register) => Some((one, inner.fieldset?)),
        BlockItemInner::Register(_) => None,
        BlockItemInner::Block(inner) => item(ir, inner.block, register),
    });
    own.or_else(|| item(ir, block.extends?, register))
}

fn all_fields(ir: &IR, name: &str) -> Vec<&'static Field> {
    let Some(set) = ir.fieldsets.iter().find(|set| is_named(set.name, name)) else { return Vec::new() };
    let parent = set.extends.map(|parent| all_fields(ir, parent)).unwrap_or_default();
    set.fields.iter().chain(parent).collect()
}

fn offsets(array: &Option<Array>) -> Vec<u32> {
    match array {
        None => vec![0],
        Some(Array::Regular(array)) => (0..array.len).map(|n| n * array.stride).collect(),
        Some(Array::Cursed(array)) => array.offsets.to_vec(),
    }
}

fn field_mask(at: &BitOffset, size: u32) -> u32 {
    let ones = |first: u32, len: u32| u32::try_from(((1u64 << len) - 1) << first).expect("the field fits in 32 bits");
    match at {
        BitOffset::Regular(at) => ones(at.offset, size),
        BitOffset::Cursed(at) => {
            at.ranges.iter().map(|range| ones(*range.start(), range.end() - range.start() + 1)).sum()
        }
    }
}

fn walk(ir: &IR, name: &str, base: u32, prefix: &str, found: &mut BTreeMap<u32, Register>) {
    let block = block(ir, name);
    if let Some(parent) = block.extends {
        walk(ir, parent, base, prefix, found);
    }
    for item in block.items {
        let array = offsets(&item.array);
        for (n, shift) in array.iter().enumerate() {
            let address = base + item.byte_offset + shift;
            let number = if array.len() > 1 { n.to_string() } else { String::new() };
            let name = format!("{prefix}.{}{number}", item.name);
            match &item.inner {
                BlockItemInner::Block(inner) => walk(ir, inner.block, address, &name, found),
                BlockItemInner::Register(register) => {
                    let of = |field: &Field| {
                        let mask = field_mask(&field.bit_offset, field.bit_size);
                        offsets(&field.array).into_iter().fold(0, |all, shift| all | mask << shift)
                    };
                    // A register without fields counts as one field of all bits.
                    let fields = register
                        .fieldset
                        .map_or(u32::MAX, |set| all_fields(ir, set).into_iter().fold(0, |all, field| all | of(field)));
                    let fields = fields & (u32::MAX >> (32 - register.bit_size));
                    // A register may have several views.
                    let entry = found.entry(address & !3).or_insert(Register { name, fields: 0 });
                    entry.fields |= fields << (8 * (address & 3));
                }
            }
        }
    }
}
