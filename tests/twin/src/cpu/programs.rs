//! Programs for the tests of the core: machine code with its disassembly.

/// A loop of 100 iterations, then sleep.
pub const COUNT: &str = "
    2064      | movs r0, #100
    3801      | 1: subs r0, #1
    d1fd      | bne 1
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Stores two words to the second part of SRAM1, in separate blocks.
pub const STORE_TWICE: &str = "
    f248 1000 | movw r0, #0x8100
    f2c2 0000 | movt r0, #0x2000
    2155      | movs r1, #0x55
    6001      | str r1, [r0]
    e7ff      | b the next
    6041      | str r1, [r0, #4]
    e7fe      | b .
";

/// Loads an address in SRAM into a register and does not use it.
pub const NO_ACCESS: &str = "
    f04f 5000 | mov.w r0, #0x20000000
    2100      | movs r1, #0
    bf30      | 2: wfi
    e7fd      | b 2
";
/// The same with a word read from the address.
pub const READ_ALIGNED: &str = "
    f04f 5000 | mov.w r0, #0x20000000
    6841      | ldr r1, [r0, #4]
    bf30      | 2: wfi
    e7fd      | b 2
";
/// The same with an unaligned read.
pub const READ_UNALIGNED: &str = "
    f04f 5000 | mov.w r0, #0x20000000
    f8d0 1002 | ldr.w r1, [r0, #2]
    bf30      | 2: wfi
    e7fd      | b 2
";
/// The same with a read from flash.
pub const READ_FLASH: &str = "
    f04f 6000 | mov.w r0, #0x08000000
    6841      | ldr r1, [r0, #4]
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Interrupt 5 has priority 0x80, 6 has 0x40. Pends 5, then records the 5 that is still in r3.
pub const NEST: &str = "
    f24e 4000 | movw r0, #0xe400
    f2ce 0000 | movt r0, #0xe000
    2180      | movs r1, #0x80
    7141      | strb r1, [r0, #5]
    2140      | movs r1, #0x40
    7181      | strb r1, [r0, #6]
    f24e 1000 | movw r0, #0xe100
    f2ce 0000 | movt r0, #0xe000
    2160      | movs r1, #0x60
    6001      | str r1, [r0]
    f64e 7200 | movw r2, #0xef00
    f2ce 0200 | movt r2, #0xe000
    f04f 5400 | mov.w r4, #0x20000000
    2305      | movs r3, #5
    6013      | str r3, [r2]
    e7ff      | b 1
    f804 3b01 | 1: strb r3, [r4], #1
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Records 1, pends 6, records 3.
pub const NEST_LOW: &str = "
    2301      | movs r3, #1
    f804 3b01 | strb r3, [r4], #1
    2306      | movs r3, #6
    6013      | str r3, [r2]
    e7ff      | b 1
    2303      | 1: movs r3, #3
    f804 3b01 | strb r3, [r4], #1
    4770      | bx lr
";
/// Records 2.
pub const NEST_HIGH: &str = "
    2302      | movs r3, #2
    f804 3b01 | strb r3, [r4], #1
    4770      | bx lr
";
/// Loads s0 to s15 from 0x2000_0100, takes interrupt 5, stores them at 0x2000_0200 with FPSCR and CONTROL.
pub const FLOATING: &str = "
    f64e 5088 | movw r0, #0xed88
    f2ce 0000 | movt r0, #0xe000
    6801      | ldr r1, [r0]
    f441 0170 | orr r1, r1, #0xf00000
    6001      | str r1, [r0]
    f3bf 8f4f | dsb sy
    f3bf 8f6f | isb sy
    f240 1000 | movw r0, #0x0100
    f2c2 0000 | movt r0, #0x2000
    ec90 0a10 | vldm r0, {s0-s15}
    f240 0100 | movw r1, #0x0000
    f2c0 0180 | movt r1, #0x0080
    eee1 1a10 | vmsr fpscr, r1
    f24e 1000 | movw r0, #0xe100
    f2ce 0000 | movt r0, #0xe000
    2120      | movs r1, #0x20
    6001      | str r1, [r0]
    f64e 7000 | movw r0, #0xef00
    f2ce 0000 | movt r0, #0xe000
    2105      | movs r1, #5
    6001      | str r1, [r0]
    e7ff      | b 1
    f240 2000 | 1: movw r0, #0x0200
    f2c2 0000 | movt r0, #0x2000
    ec80 0a10 | vstm r0, {s0-s15}
    eef1 1a10 | vmrs r1, fpscr
    6401      | str r1, [r0, #64]
    f3ef 8114 | mrs r1, control
    6441      | str r1, [r0, #68]
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Records SP, LR and CONTROL at 0x2000_0300, then overwrites s0 to s15 and FPSCR.
pub const FLOATING_HANDLER: &str = "
    f240 3000 | movw r0, #0x0300
    f2c2 0000 | movt r0, #0x2000
    f8c0 d000 | str.w sp, [r0]
    f8c0 e004 | str.w lr, [r0, #4]
    f3ef 8114 | mrs r1, control
    6081      | str r1, [r0, #8]
    f240 4000 | movw r0, #0x0400
    f2c2 0000 | movt r0, #0x2000
    ec90 0a10 | vldm r0, {s0-s15}
    2100      | movs r1, #0
    eee1 1a10 | vmsr fpscr, r1
    4770      | bx lr
";
/// On a process stack aligned to 4 only: takes interrupt 5, records SP, CONTROL and MSP at 0x2000_0200.
pub const PROCESS: &str = "
    f243 0004 | movw r0, #0x3004
    f2c2 0000 | movt r0, #0x2000
    f380 8809 | msr psp, r0
    2002      | movs r0, #2
    f380 8814 | msr control, r0
    f3bf 8f6f | isb sy
    f24e 1000 | movw r0, #0xe100
    f2ce 0000 | movt r0, #0xe000
    2120      | movs r1, #0x20
    6001      | str r1, [r0]
    f64e 7000 | movw r0, #0xef00
    f2ce 0000 | movt r0, #0xe000
    2105      | movs r1, #5
    6001      | str r1, [r0]
    e7ff      | b 1
    f240 2000 | 1: movw r0, #0x0200
    f2c2 0000 | movt r0, #0x2000
    f8c0 d000 | str.w sp, [r0]
    f3ef 8114 | mrs r1, control
    6041      | str r1, [r0, #4]
    f3ef 8108 | mrs r1, msp
    6081      | str r1, [r0, #8]
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Records SP, LR and PSP at 0x2000_0300.
pub const PROCESS_HANDLER: &str = "
    f240 3000 | movw r0, #0x0300
    f2c2 0000 | movt r0, #0x2000
    f8c0 d000 | str.w sp, [r0]
    f8c0 e004 | str.w lr, [r0, #4]
    f3ef 8109 | mrs r1, psp
    6081      | str r1, [r0, #8]
    4770      | bx lr
";
/// Waits in WFE with interrupts masked for SysTick, 10000 cycles away. Records the time of the wake-up and the number
/// of interrupts served.
pub const EVENT: &str = "
    f24e 0400 | movw r4, #0xe000
    f2ce 0400 | movt r4, #0xe000
    f241 0500 | movw r5, #0x1000
    f2ce 0500 | movt r5, #0xe000
    f04f 5600 | mov.w r6, #0x20000000
    2001      | movs r0, #1
    6028      | str r0, [r5]
    2010      | movs r0, #0x10
    f8c4 0d10 | str.w r0, [r4, #0xd10]
    f242 700f | movw r0, #9999
    6160      | str r0, [r4, #0x14]
    b672      | cpsid i
    bf40      | sev
    bf20      | wfe
    2007      | movs r0, #7
    6120      | str r0, [r4, #0x10]
    bf20      | wfe
    6869      | ldr r1, [r5, #4]
    6071      | str r1, [r6, #4]
    6831      | ldr r1, [r6]
    60b1      | str r1, [r6, #8]
    b662      | cpsie i
    e7ff      | b 1
    6831      | 1: ldr r1, [r6]
    60f1      | str r1, [r6, #12]
    bf20      | 2: wfe
    e7fd      | b 2
";
/// The same with WFI.
pub const WAIT: &str = "
    f24e 0400 | movw r4, #0xe000
    f2ce 0400 | movt r4, #0xe000
    f241 0500 | movw r5, #0x1000
    f2ce 0500 | movt r5, #0xe000
    f04f 5600 | mov.w r6, #0x20000000
    2001      | movs r0, #1
    6028      | str r0, [r5]
    f242 700f | movw r0, #9999
    6160      | str r0, [r4, #0x14]
    b672      | cpsid i
    2007      | movs r0, #7
    6120      | str r0, [r4, #0x10]
    bf30      | wfi
    6869      | ldr r1, [r5, #4]
    6071      | str r1, [r6, #4]
    6831      | ldr r1, [r6]
    60b1      | str r1, [r6, #8]
    b662      | cpsie i
    e7ff      | b 1
    6831      | 1: ldr r1, [r6]
    60f1      | str r1, [r6, #12]
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Stops SysTick and increments the count.
pub const TICK: &str = "
    2000      | movs r0, #0
    6120      | str r0, [r4, #0x10]
    6830      | ldr r0, [r6]
    3001      | adds r0, #1
    6030      | str r0, [r6]
    4770      | bx lr
";
/// Interrupt 5 with priority 0x60, masked by BASEPRI 0x40. Records its count before and after unmasking.
pub const BASE: &str = "
    f24e 0400 | movw r4, #0xe000
    f2ce 0400 | movt r4, #0xe000
    f04f 5600 | mov.w r6, #0x20000000
    2060      | movs r0, #0x60
    f884 0405 | strb.w r0, [r4, #0x405]
    2020      | movs r0, #0x20
    f8c4 0100 | str.w r0, [r4, #0x100]
    2040      | movs r0, #0x40
    f380 8811 | msr basepri, r0
    2005      | movs r0, #5
    f8c4 0f00 | str.w r0, [r4, #0xf00]
    e7ff      | b 1
    6831      | 1: ldr r1, [r6]
    6071      | str r1, [r6, #4]
    2000      | movs r0, #0
    f380 8811 | msr basepri, r0
    e7ff      | b 2
    6831      | 2: ldr r1, [r6]
    60b1      | str r1, [r6, #8]
    bf30      | 3: wfi
    e7fd      | b 3
";
/// Increments the count.
pub const COUNT_HANDLER: &str = "
    6830      | ldr r0, [r6]
    3001      | adds r0, #1
    6030      | str r0, [r6]
    4770      | bx lr
";
/// A supervisor call; records its count.
pub const CALL: &str = "
    f04f 5600 | mov.w r6, #0x20000000
    df03      | svc #3
    6831      | ldr r1, [r6]
    6071      | str r1, [r6, #4]
    bf30      | 1: wfi
    e7fd      | b 1
";
/// An undefined instruction.
pub const UNDEFINED: &str = "
    f04f 5600 | mov.w r6, #0x20000000
    bf00      | nop
    de00      | udf #0
    e7fe      | b .
";
/// Reads address 4.
pub const BAD_READ: &str = "
    f04f 5600 | mov.w r6, #0x20000000
    2000      | movs r0, #0
    6841      | ldr r1, [r0, #4]
    e7fe      | b .
";
/// Reads the address of SPI3, which has no model.
pub const BAD_REGISTER: &str = "
    f643 4000 | movw r0, #0x3c00
    f2c4 0000 | movt r0, #0x4000
    6801      | ldr r1, [r0]
    e7fe      | b .
";
/// Uses the FPU while it is off.
pub const FLOAT_TOO_EARLY: &str = "
    2000      | movs r0, #0
    ee00 0a10 | vmov s0, r0
    e7ff      | b 1
    e7fe      | 1: b 1
";
/// Jumps to the boot loader through its vectors.
pub const TO_ROM: &str = "
    2000      | movs r0, #0
    f6c1 70ff | movt r0, #0x1fff
    6801      | ldr r1, [r0]
    f381 8808 | msr msp, r1
    6841      | ldr r1, [r0, #4]
    4708      | bx r1
";
/// Counts its starts in RAM and loops at the third.
pub const RESTART: &str = "
    f04f 5600 | mov.w r6, #0x20000000
    6830      | ldr r0, [r6]
    3001      | adds r0, #1
    6030      | str r0, [r6]
    2803      | cmp r0, #3
    d00b      | beq 2
    f64e 510c | movw r1, #0xed0c
    f2ce 0100 | movt r1, #0xe000
    f240 0204 | movw r2, #0x0004
    f2c0 52fa | movt r2, #0x05fa
    600a      | str r2, [r1]
    f3bf 8f4f | dsb sy
    e7fe      | 1: b 1
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Wakes every 2^24 cycles by SysTick and records the cycle counter.
pub const CLOCKED: &str = "
    f24e 0400 | movw r4, #0xe000
    f2ce 0400 | movt r4, #0xe000
    f241 0500 | movw r5, #0x1000
    f2ce 0500 | movt r5, #0xe000
    f04f 5600 | mov.w r6, #0x20000000
    2001      | movs r0, #1
    6028      | str r0, [r5]
    f06f 407f | mvn r0, #0xff000000
    6160      | str r0, [r4, #0x14]
    2007      | movs r0, #7
    6120      | str r0, [r4, #0x10]
    bf30      | 1: wfi
    6869      | ldr r1, [r5, #4]
    6071      | str r1, [r6, #4]
    e7fb      | b 1
";
/// Reads the first word of the settings.
pub const READ_BANK_2: &str = "
    f24c 0000 | movw r0, #0xc000
    f6c0 0007 | movt r0, #0x0807
    6801      | ldr r1, [r0]
    bf30      | 1: wfi
    e7fd      | b 1
";
/// Sets the GE flags, takes interrupt 5, then selects by the flags.
pub const GREATER: &str = "
    f24e 1000 | movw r0, #0xe100
    f2ce 0000 | movt r0, #0xe000
    2120      | movs r1, #0x20
    6001      | str r1, [r0]
    f04f 5600 | mov.w r6, #0x20000000
    f04f 3201 | mov.w r2, #0x01010101
    f04f 13ff | mov.w r3, #0x00ff00ff
    fac2 f143 | usub8 r1, r2, r3
    2000      | movs r0, #0
    2801      | cmp r0, #1
    f64e 7000 | movw r0, #0xef00
    f2ce 0000 | movt r0, #0xe000
    f04f 0105 | mov.w r1, #5
    6001      | str r1, [r0]
    e7ff      | b 1
    faa2 f183 | 1: sel r1, r2, r3
    6031      | str r1, [r6]
    f3ef 8100 | mrs r1, apsr
    6071      | str r1, [r6, #4]
    bf30      | 2: wfi
    e7fd      | b 2
";
/// Clears all flags.
pub const GREATER_HANDLER: &str = "
    2000      | movs r0, #0
    f380 8c00 | msr apsr_nzcvqg, r0
    4770      | bx lr
";
/// Loops forever.
pub const WAIT_FOREVER: &str = "
    e7fe      | b .
";
/// Returns.
pub const NOTHING: &str = "
    4770      | bx lr
";
