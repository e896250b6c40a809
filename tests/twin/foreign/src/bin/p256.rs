//! Signs and verifies by `p256-cm4`, whose cycles on a chip of ST are published: with two wait states, as there, and asleep
//! between the two.

#![no_main]
#![no_std]

use core::array;
use cortex_m::{asm, peripheral::syst::SystClkSource};
use cortex_m_rt::{entry, exception};
use defmt_rtt as _;
use p256_cm4::{convert_endianness, octet_string_to_point};
use panic_probe as _;
use stm32_hal2::pac;

/// Longer than either takes, at the 16 MHz of reset: 0.5 s.
const TICK: u32 = 8_000_000;
const WAIT_STATES: u8 = 2;

/// A number of 256 bits, its most significant byte first.
type Bytes = [u8; 32];
/// The same for the library: words, the least significant first.
type Words = [u32; 8];

/// Appendix A.2.5 of RFC 6979, the message "sample" with SHA-256.
const PRIVATE_KEY: Bytes = number("C9AFA9D845BA75166B5C215767B1D6934E50C3DB36E89B127B8A622B120F6721");
const PUBLIC_X: Bytes = number("60FED4BA255A9D31C961EB74C6356D68C049B8923B61FA6CE669622E60F29FB6");
const PUBLIC_Y: Bytes = number("7903FE1008B8BC99A41AE9E95628BC64F2F1B20C2D7E9F5177A3C294D4462299");
const HASH: Bytes = number("AF2BDBE1AA9B6EC1E2ADE1D694F41FC71A831D0268E9891562113D8A62ADD1BF");
const ONCE: Bytes = number("A6E3C57DD01ABE90086538398355DD4C3B17AA873382B0F24D6129493D8AAD60");
const R: Bytes = number("EFD48B2AACB6A8FD1140DD9CD45E81D69D2C877B56AAF991C34D0EA84EAF3716");
const S: Bytes = number("F7CB1C942D657C41D436C7A1B6E29F65F3E900DBB9AFF4064DC4AB2F843ACDA8");

const fn number(digits: &str) -> Bytes {
    let digits = digits.as_bytes();
    let mut bytes = [0; 32];
    let mut at = 0;
    while at < 64 {
        let value = if digits[at] <= b'9' { digits[at] - b'0' } else { digits[at] - b'A' + 10 };
        bytes[at / 2] = bytes[at / 2] << 4 | value;
        at += 1;
    }
    bytes
}

fn words(bytes: &Bytes) -> Words {
    let mut least_first = [0; 32];
    convert_endianness(&mut least_first, bytes);
    array::from_fn(|n| u32::from_le_bytes(array::from_fn(|byte| least_first[4 * n + byte])))
}

#[inline(never)]
fn sign() -> (Words, Words) {
    let (mut r, mut s) = ([0; 8], [0; 8]);
    assert!(p256_cm4::sign(&mut r, &mut s, &HASH, &words(&PRIVATE_KEY), &words(&ONCE)));
    (r, s)
}

#[inline(never)]
fn verify(x: &Words, y: &Words) -> bool {
    p256_cm4::verify(x, y, &HASH, &words(&R), &words(&S))
}

#[entry]
fn main() -> ! {
    let mut core = cortex_m::Peripherals::take().unwrap();
    let dp = pac::Peripherals::take().unwrap();
    // Caches are on after reset.
    // SAFETY: more wait states than 16 MHz need.
    dp.FLASH.acr().modify(|_, w| unsafe { w.latency().bits(WAIT_STATES) });

    let mut public = [4; 65];
    public[1..33].copy_from_slice(&PUBLIC_X);
    public[33..].copy_from_slice(&PUBLIC_Y);
    let (mut x, mut y) = ([0; 8], [0; 8]);
    assert!(octet_string_to_point(&mut x, &mut y, &public));

    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(TICK - 1);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();
    asm::wfi();
    assert_eq!(sign(), (words(&R), words(&S)));
    asm::wfi();
    assert!(verify(&x, &y));
    loop {
        asm::wfi();
    }
}

#[exception]
fn SysTick() {}
