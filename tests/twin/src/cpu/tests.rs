//! Tests of the core alone: small programs instead of the firmware.

use super::{programs::*, *};
use crate::{Board, chip::errata::Errata, world::Still};

/// First instruction of the program, after the vectors.
const CODE: u32 = flash::START + 0x200;
const STACK: u32 = 0x2000_4000;
/// Address to which programs write their results.
const NOTES: u32 = RAM_START;

/// A core with a program, and exception handlers by exception number.
fn core(program: &str, handlers: &[(usize, &str)]) -> Cpu {
    let mut chip = Chip::new(Board::NUCLEO, Box::new(Still));
    let mut vectors = [STACK, CODE | 1].map(u32::to_le_bytes).concat();
    vectors.resize(0x200, 0);
    let mut code = assemble(program);
    for (exception, handler) in handlers {
        code.resize(code.len().next_multiple_of(4), 0);
        let at = CODE + code.len() as u32;
        vectors[4 * exception..][..4].copy_from_slice(&(at | 1).to_le_bytes());
        code.extend(assemble(handler));
    }
    assert!(chip.flash.load(flash::START, &vectors) && chip.flash.load(CODE, &code));
    let mut cpu = Cpu::new(chip).expect("the core is created");
    cpu.reset().expect("the core starts");
    cpu
}

/// The code in a listing: hexadecimal half-words before the bar.
fn assemble(listing: &str) -> Vec<u8> {
    let lines = listing.lines().filter_map(|line| line.split_once('|'));
    let halves = lines.flat_map(|(code, _)| code.split_whitespace());
    halves.flat_map(|half| u16::from_str_radix(half, 16).expect("hexadecimal").to_le_bytes()).collect()
}

fn word(cpu: &Cpu, address: u32) -> u32 {
    let bytes = cpu.core().chip.bytes(address, 4).expect("address in RAM");
    u32::from_le_bytes(bytes.try_into().expect("four bytes"))
}

fn put(cpu: &mut Cpu, address: u32, words: &[u32]) {
    let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
    cpu.core_mut().chip.ram_mut(address, bytes.len()).expect("address in RAM").copy_from_slice(&bytes);
}

#[test]
fn an_instruction_is_a_cycle_and_sleep_is_free() {
    let mut cpu = core(COUNT, &[]);
    assert_eq!(cpu.run(100_000), Ok(None));
    let core = cpu.core();
    assert_eq!((core.instructions, core.now, core.slept), (1 + 2 * 100 + 1, 100_000, 100_000 - 202));
}

#[test]
fn the_first_write_to_a_part_of_memory_is_lost_by_an_erratum_only() {
    for (errata, first) in [(Errata { first_write_lost: true, ..Errata::NONE }, 0), (Errata::NONE, 0x55)] {
        let mut cpu = core(STORE_TWICE, &[]);
        cpu.core_mut().chip.set_errata(errata);
        cpu.reset().expect("the core starts");
        assert_eq!(cpu.run(1_000), Ok(None));
        assert_eq!([word(&cpu, 0x2000_8100), word(&cpu, 0x2000_8104)], [first, 0x55]);
        let lost: &[u32] = if first == 0 { &[0x2000_8100] } else { &[] };
        assert_eq!((&cpu.core().lost_writes[..], &cpu.core().first_writes[..]), (lost, lost));
    }
}

#[test]
fn cycles_are_counted_beside_the_clock_while_awake() {
    let mut cpu = core(COUNT, &[]);
    cpu.count_cycles().expect("the hooks are installed");
    assert_eq!(cpu.run(100_000), Ok(None));
    let core = cpu.core();
    assert_eq!((core.instructions, core.slept), (202, 100_000 - 202), "time is as ever");
    // 99 of 100 branches are taken. Without wait states, the pessimistic bound adds three further reads for the line.
    assert_eq!(core.cycles(), Some(Range::new(202 + 99, 202 + 3 * 99 + 3)));
}

#[test]
fn what_is_done_on_the_bus_is_in_the_count() {
    let counted = |program: &str| {
        let mut cpu = core(program, &[]);
        cpu.count_cycles().expect("the hooks are installed");
        assert_eq!(cpu.run(1000), Ok(None));
        cpu.core().cycles().expect("cycles are counted")
    };
    let nothing = counted(NO_ACCESS);
    let more = |program: &str| {
        let cycles = counted(program);
        (cycles.least - nothing.least, cycles.most - nothing.most)
    };
    assert_eq!(more(READ_ALIGNED), (1, 2), "a load instead of a move, its address just written");
    assert_eq!(more(READ_UNALIGNED), (2, 4));
    // Without wait states: one cycle of contention, and three further reads for another line.
    assert_eq!(more(READ_FLASH), (1, 6));
}

#[test]
fn the_run_stops_between_blocks_and_goes_on_as_if_it_had_not() {
    let whole = |slice: Cycles| {
        let mut cpu = core(NEST, &[(21, NEST_LOW), (22, NEST_HIGH)]);
        for until in (slice..1000).step_by(slice as usize).chain([1000]) {
            assert_eq!(cpu.run(until), Ok(None));
        }
        (cpu.core().instructions, cpu.core().slept, word(&cpu, NOTES))
    };
    assert_eq!(whole(1), whole(1000));
    assert_eq!(whole(7), whole(1000));
}

#[test]
fn the_more_urgent_interrupt_interrupts_and_registers_come_back() {
    let mut cpu = core(NEST, &[(21, NEST_LOW), (22, NEST_HIGH)]);
    assert_eq!(cpu.run(1000), Ok(None));
    assert_eq!(word(&cpu, NOTES).to_le_bytes(), [1, 2, 3, 5]);
    let core = cpu.core();
    assert_eq!((core.taken[21], core.taken[22], core.deepest), (1, 1, 2));
    assert_eq!(cpu.register(R::SP), STACK);
}

#[test]
fn a_floating_point_frame_keeps_all_that_a_handler_may_spoil() {
    let mut cpu = core(FLOATING, &[(21, FLOATING_HANDLER)]);
    let values: Vec<u32> = (0..16).map(|n| (1.5f32 + n as f32).to_bits()).collect();
    put(&mut cpu, 0x2000_0100, &values);
    put(&mut cpu, 0x2000_0400, &[f32::NAN.to_bits(); 16]);
    assert_eq!(cpu.run(1000), Ok(None));
    for (n, &value) in (0..).zip(&values) {
        assert_eq!(word(&cpu, 0x2000_0200 + 4 * n), value, "s{n}");
    }
    assert_eq!(word(&cpu, 0x2000_0240), 0x0080_0000, "FPSCR");
    assert_eq!(word(&cpu, 0x2000_0244) & FPCA, FPCA);
    let [stack, link, control] = [0, 4, 8].map(|at| word(&cpu, 0x2000_0300 + at));
    assert_eq!((stack, link, control & FPCA), (STACK - 0x68, 0xffff_ffe9, 0));
}

#[test]
fn a_thread_on_the_process_stack_is_stacked_there_on_a_multiple_of_eight() {
    let mut cpu = core(PROCESS, &[(21, PROCESS_HANDLER)]);
    assert_eq!(cpu.run(1000), Ok(None));
    let [stack, link, process] = [0, 4, 8].map(|at| word(&cpu, 0x2000_0300 + at));
    assert_eq!((stack, link, process), (STACK, 0xffff_fffd, 0x2000_3004 - 4 - 0x20));
    let [stack, control, main] = [0, 4, 8].map(|at| word(&cpu, 0x2000_0200 + at));
    assert_eq!((stack, control & SPSEL, main), (0x2000_3004, SPSEL, STACK));
}

#[test]
fn a_masked_interrupt_ends_wfe_and_is_served_after_opening() {
    for (program, sleeps) in [(EVENT, "WFE"), (WAIT, "WFI")] {
        let mut cpu = core(program, &[(15, TICK)]);
        put(&mut cpu, NOTES, &[0]);
        assert_eq!(cpu.run(50_000), Ok(None));
        let [woken, masked, opened] = [4, 8, 12].map(|at| word(&cpu, NOTES + at));
        assert!((10_000..10_030).contains(&woken), "{sleeps} woke at {woken}");
        assert_eq!((masked, opened), (0, 1), "{sleeps}");
        assert!(cpu.core().slept > 49_000, "{sleeps}");
    }
}

#[test]
fn basepri_holds_back_what_is_not_more_urgent() {
    let mut cpu = core(BASE, &[(21, COUNT_HANDLER)]);
    put(&mut cpu, NOTES, &[0]);
    assert_eq!(cpu.run(1000), Ok(None));
    assert_eq!([4, 8].map(|at| word(&cpu, NOTES + at)), [0, 1]);
}

#[test]
fn a_supervisor_call_comes_back_behind_itself() {
    let mut cpu = core(CALL, &[(SV_CALL, COUNT_HANDLER)]);
    put(&mut cpu, NOTES, &[0]);
    assert_eq!(cpu.run(1000), Ok(None));
    assert_eq!(word(&cpu, NOTES + 4), 1);
}

#[test]
fn flags_of_greater_or_equal_come_back() {
    let mut cpu = core(GREATER, &[(21, GREATER_HANDLER)]);
    assert_eq!(cpu.run(1000), Ok(None));
    assert_eq!(cpu.core().taken[21], 1);
    // Bytes 1 and 3 are greater than or equal.
    assert_eq!(word(&cpu, NOTES), 0x01ff_01ff);
    assert_eq!(word(&cpu, NOTES + 4), 0x800a_0000, "negative by the comparison, and the flags of bytes 1 and 3");
}

#[test]
fn faults_end_the_run_where_they_happen() {
    let stopped = |program: &str| {
        let mut cpu = core(program, &[(3, COUNT_HANDLER)]);
        let stop = cpu.run(1000).expect_err("a fault");
        (stop, cpu.pc())
    };
    assert_eq!(stopped(UNDEFINED), (Stop::Undefined, CODE + 6));
    assert_eq!(stopped(BAD_READ), (Stop::Unmapped { what: "read of", address: 4 }, CODE + 6));
    let (stop, pc) = stopped(BAD_REGISTER);
    assert!(matches!(&stop, Stop::Bus(bad) if bad.address == 0x4000_3c00), "{stop}");
    assert_eq!(pc, CODE, "the block that made the access");
    assert_eq!(stopped(FLOAT_TOO_EARLY).0, Stop::FloatingPointOff);
    assert_eq!(stopped(TO_ROM).0, Stop::Bootloader);
}

#[test]
fn a_fault_can_be_taken_and_one_inside_its_handler_locks_the_core_up() {
    for (program, stacked) in [(UNDEFINED, CODE + 6), (BAD_READ, CODE + 6)] {
        let mut cpu = core(program, &[(3, WAIT_FOREVER)]);
        cpu.faults = Faults::Taken;
        assert_eq!(cpu.run(1000), Ok(None));
        assert_eq!(cpu.core().taken[3], 1);
        assert_eq!(word(&cpu, STACK - 8), stacked, "return address in the frame");
        let mut cpu = core(program, &[(3, UNDEFINED)]);
        cpu.faults = Faults::Taken;
        assert_eq!(cpu.run(1000), Err(Stop::LockUp));
    }
}

#[test]
fn an_error_in_flash_raises_the_interrupt_that_nothing_masks() {
    let mut cpu = core(READ_BANK_2, &[(2, WAIT_FOREVER)]);
    // A torn double word, as after a power failure.
    let flash = &mut cpu.core_mut().chip.flash;
    flash.tear_for_test(0x0807_c000);
    assert_eq!(cpu.run(1000), Ok(None));
    assert_eq!(cpu.core().taken[2], 1);
}

#[test]
fn a_reset_by_software_keeps_ram() {
    let mut cpu = core(RESTART, &[]);
    put(&mut cpu, NOTES, &[0]);
    for _ in 0..2 {
        assert_eq!(cpu.run(1000), Ok(Some(Reset::Software)));
        cpu.reset().expect("the core starts");
    }
    assert!(cpu.now() < 50, "at once");
    assert_eq!(cpu.run(1000), Ok(None));
    assert_eq!(word(&cpu, NOTES), 3);
}

#[test]
fn time_goes_on_over_32_bits_and_the_cycle_counter_wraps() {
    let mut cpu = core(CLOCKED, &[(15, NOTHING)]);
    let period = 1u64 << 24;
    let (before, after) = ((1 << 32) - period / 2, (1u64 << 32) + period / 2);
    assert_eq!(cpu.run(before), Ok(None));
    let noted = word(&cpu, NOTES + 4);
    assert_eq!(cpu.run(after), Ok(None));
    assert!(word(&cpu, NOTES + 4) < noted);
    assert_eq!(cpu.now(), after);
}
