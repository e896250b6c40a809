//! Programming through a debug probe, for a board that has no firmware yet, or whose firmware does not answer.
//!
//! Only pages of the image are erased, so the settings are kept. Everything except the probe itself is here, behind
//! [`Probes`]; the probe is probe-rs's, in a program built with the feature `probe`.

mod error;
mod probe;
#[cfg(feature = "probe")]
mod probe_rs;

pub use error::FlashError;
pub use probe::{Probe, Probes, Work};

use crate::image::Image;

/// What was programmed, and through which probe.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Flashed {
    /// The probe.
    pub probe: Probe,
    /// Serial number of the device, the same as over USB.
    pub serial: String,
}

/// Writes the image through the only probe, or through the one that `words` selects. `tell` is called with that probe.
pub fn flash(
    probes: &mut dyn Probes,
    words: Option<&str>,
    chip: &str,
    image: &Image,
    tell: &mut dyn FnMut(&Probe),
    progress: &mut dyn FnMut(Work, u64, u64),
) -> Result<Flashed, FlashError> {
    let probe = choose(probes.list()?, words)?;
    if !probe.accessible {
        return Err(FlashError::Permission { vid: format!("{:04x}", probe.vid), probe: probe.to_string() });
    }
    tell(&probe);
    let serial = probes.program(&probe, chip, image, progress)?;
    Ok(Flashed { probe, serial })
}

fn choose(probes: Vec<Probe>, words: Option<&str>) -> Result<Probe, FlashError> {
    let list = |probes: &[Probe]| probes.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
    if probes.is_empty() {
        return Err(FlashError::NoProbe);
    }
    let meant = |probe: &&Probe| words.is_none_or(|words| probe.matches(words));
    let chosen: Vec<Probe> = probes.iter().filter(meant).cloned().collect();
    match (chosen.as_slice(), words) {
        ([one], _) => Ok(one.clone()),
        ([], words) => Err(FlashError::NoSuchProbe { words: words.unwrap_or_default().into(), probes: list(&probes) }),
        (several, _) => Err(FlashError::SeveralProbes { probes: list(several) }),
    }
}

/// The probes of this machine.
#[cfg(feature = "probe")]
pub fn probes() -> Result<Box<dyn Probes>, FlashError> {
    Ok(Box::new(probe_rs::Attached))
}

/// No probes: this program was built without them.
#[cfg(not(feature = "probe"))]
pub fn probes() -> Result<Box<dyn Probes>, FlashError> {
    Err(FlashError::BuiltWithout)
}

#[cfg(test)]
mod tests {
    use super::{probe::ChipFacts, *};
    use crate::image::sample;

    fn probe(pid: u16, serial: Option<&str>) -> Probe {
        let serial = serial.map(str::to_string);
        Probe { name: "STLink V3".into(), vid: 0x0483, pid, serial, accessible: true }
    }

    struct FakeProbes {
        probes: Vec<Probe>,
        programmed: Vec<(String, String)>,
    }

    impl Probes for FakeProbes {
        fn list(&mut self) -> Result<Vec<Probe>, FlashError> {
            Ok(self.probes.clone())
        }

        fn program(
            &mut self,
            probe: &Probe,
            chip: &str,
            _: &Image,
            progress: &mut dyn FnMut(Work, u64, u64),
        ) -> Result<String, FlashError> {
            progress(Work::Writing, 1, 2);
            self.programmed.push((probe.selector(), chip.into()));
            Ok("205735883537".into())
        }
    }

    fn run(probes: Vec<Probe>, words: Option<&str>) -> (Result<Flashed, FlashError>, Vec<(String, String)>) {
        let mut bench = FakeProbes { probes, programmed: Vec::new() };
        let image = sample(3000, "inerter 0.1.0");
        let result = flash(&mut bench, words, crate::board::CHIP, &image, &mut |_| {}, &mut |_, _, _| {});
        (result, bench.programmed)
    }

    #[test]
    fn the_only_probe_needs_no_words_and_several_are_told_apart() {
        let (a, b) = (probe(0x374E, Some("AB12")), probe(0x3748, Some("CD34")));
        let (flashed, programmed) = run(vec![a.clone()], None);
        assert_eq!(flashed.unwrap(), Flashed { probe: a.clone(), serial: "205735883537".into() });
        assert_eq!(programmed, [("0483:374e:AB12".to_string(), "STM32G474RETx".to_string())]);
        for words in ["ab12", "0483:374E", "0483:374e:AB12"] {
            assert_eq!(run(vec![a.clone(), b.clone()], Some(words)).0.unwrap().probe, a);
        }
        let (error, programmed) = run(vec![a.clone(), b.clone()], None);
        let words = "several debug probes are plugged in: STLink V3 (0483:374e:AB12), STLink V3 (0483:3748:CD34)";
        assert_eq!(error.unwrap_err().to_string(), words);
        assert!(programmed.is_empty());
        let error = run(vec![a.clone(), b], Some("EF56")).0.unwrap_err();
        assert!(matches!(error, FlashError::NoSuchProbe { .. }), "{error}");
        let error = run(vec![a.clone(), a], Some("0483:374e")).0.unwrap_err();
        assert!(matches!(error, FlashError::SeveralProbes { .. }), "{error}");
        assert!(matches!(run(vec![], Some("AB12")).0, Err(FlashError::NoProbe)));
        assert_eq!(run(vec![probe(1, None)], None).0.unwrap().probe.selector(), "0483:0001");
    }

    #[test]
    fn a_chip_on_which_the_firmware_cannot_run_is_refused() {
        // As owners of NUCLEO boards report them, with nSWBOOT0 = 0, and as in the manual.
        let delivered = [0xFBEF_F8AA, 0xFFEF_F8AA];
        let check = |device, flash_kb, options| ChipFacts { device, flash_kb, options }.check();
        for options in delivered {
            check(0x469, 512, options).unwrap();
            assert!(matches!(check(0x468, 512, options), Err(FlashError::OtherChip { found: 0x468, .. })));
            for kb in [128, 256] {
                let error = check(0x469, kb, options).unwrap_err();
                let words = format!("the chip has {kb} KB of flash; image and settings need 512 KB");
                assert_eq!(error.to_string(), words);
            }
            assert!(matches!(check(0x469, 512, options & !(1 << 22)), Err(FlashError::SingleBank)));
        }
        assert!(matches!(check(0x469, 512, delivered[0] & !(1 << 27)), Err(FlashError::NoStart)));
        check(0x469, 512, delivered[1] & !(1 << 27)).unwrap();
    }

    #[test]
    fn a_probe_that_may_not_be_opened_is_not_tried() {
        let (error, programmed) = run(vec![Probe { accessible: false, ..probe(0x374E, None) }], None);
        assert!(matches!(error, Err(FlashError::Permission { .. })));
        assert!(programmed.is_empty());
    }
}
