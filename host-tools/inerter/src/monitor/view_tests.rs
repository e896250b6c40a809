use inerter_core::{
    Backlash, BacklashSize, Detail, Estimate, Interval, Law, LawStatus, Machine, Misfit, Parameter, Parameters,
    Settings,
};
use inerter_wire::{Estimated, Health, Hello};
use ratatui::{Terminal, backend::TestBackend};

use super::*;
use crate::{
    hostile::{SHOWN, WORDS, hello, monitored},
    monitor::feed::{Item, Moment, Sample},
};

fn at(run_s: f64) -> Moment {
    Moment { run_s, unix_ns: 0 }
}

/// A state in which everything has something to show.
fn state() -> State {
    state_of(Machine::Linear)
}

fn state_of(machine: Machine) -> State {
    let mut state = State::new(Some("run.mcap".into()), vec!["page: http://127.0.0.1:1/".into()]);
    let hello = hello("test 1.0", "board", "S7", 100.0);
    let settings = Settings { sample_rate_hz: 100.0, machine, ..Settings::default() };
    let mut items = vec![Item::Device { port: "COM3".into(), hello, settings }];
    let known = |value, u95| Parameter::Ok(Interval { value, u95 });
    for index in 0..1000 {
        let run_s = f64::from(index) * 0.01;
        let sample = Sample { at: at(run_s), force_n: 400.0 * run_s.sin(), position_m: 1e-3, terminal_m: None };
        items.push(Item::Samples(vec![sample]));
        if index % 10 == 9 {
            let recent = Parameters {
                inertance_kg: known(95.11, 0.48),
                viscous_n_s_per_m: Parameter::default(),
                coulomb_n: Parameter::Held(Interval { value: 31.4, u95: 1.2 }),
                offset_n: known(-0.5, 0.1),
            };
            let estimate = Estimate { recent, whole_run: recent, moving: true, ..Estimate::default() };
            let backlash = Backlash {
                size: BacklashSize::Ok(Interval { value: 5e-5, u95: 1.2e-6 }),
                reversals: 12,
                ..Backlash::default()
            };
            let detail = Some(Detail { backlash, ..Detail::default() });
            let misfit = Some(Misfit { ratio: 1.02, limit: 1.4 });
            let law = Some(Law { status: LawStatus::Holds, misfit, ..Law::default() });
            items.push(Item::Estimate { at: at(run_s), t_s: run_s, estimated: Estimated { estimate, law, detail } });
        }
    }
    items.push(Item::Health(Health { saturated: 3, cpu_load_permille: Some(345), ..Health::default() }));
    items.push(Item::Marker { at: at(8.0), t_s: None, text: "bolt tightened".into() });
    for item in items {
        state.item(&item);
    }
    state
}

/// The screen as lines, and whether any cell has a colour.
fn drawn(state: &State, width: u16, height: u16, colour: bool) -> (Vec<String>, bool) {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw(frame, state, Theme { colour })).unwrap();
    let buffer = terminal.backend().buffer();
    let row = |y| (0..width).map(|x| buffer[(x, y)].symbol()).collect::<String>();
    let coloured = buffer
        .content()
        .iter()
        .any(|cell| cell.fg != ratatui::style::Color::Reset || cell.bg != ratatui::style::Color::Reset);
    ((0..height).map(row).collect(), coloured)
}

#[test]
fn the_overview_fits_a_small_terminal() {
    let (lines, _) = drawn(&state(), 80, 24, true);
    let screen = lines.join("\n");
    assert!(lines[0].starts_with("● run.mcap  board S7  100 Hz  10.0 s  COM3"), "{screen}");
    for words in [
        "│Effective inertance  kg    95.11 ± 0.48      ok               95.11 ± 0.48    │",
        "│Viscous friction     N s/m -                 not identifiable -               │",
        "│Coulomb friction     N     31.4 ± 1.2        held             31.4 ± 1.2      │",
        "│Backlash             µm                      ok               50.0 ± 1.2      │",
        "3 saturated samples, processor 34 %",
        "Force [N]",
        "-5 s",
        "now",
    ] {
        assert!(screen.contains(words), "{words}\n{screen}");
    }
    assert!(lines[23].starts_with("q quit  ? keys"), "{screen}");
    // The curve is drawn, in Braille.
    assert!(screen.chars().any(|letter| ('\u{2801}'..='\u{28ff}').contains(&letter)), "{screen}");
}

#[test]
fn a_rotary_machine_has_its_names_and_units_on_every_pane() {
    let mut state = state_of(Machine::Rotary);
    for (tab, words) in [
        (Tab::Overview, &["Effective inertia", "kg m² 95.11 ± 0.48", "N m s", "µrad", "Torque [N m]"][..]),
        (Tab::Signals, &["Torque [N m]", "Rotor angle [mrad]"]),
        (Tab::Parameters, &["Effective inertia 95.11 ± 0.48 kg m²", "Backlash 50.0 ± 1.2 µrad"]),
    ] {
        state.tab = tab;
        let screen = drawn(&state, 100, 40, true).0.join("\n");
        for word in words {
            assert!(screen.contains(word), "{word}\n{screen}");
        }
        for word in ["nertance", "[N]", "orce", "[mm]", "µm"] {
            assert!(!screen.contains(word), "{word}\n{screen}");
        }
    }
}

#[test]
fn every_pane_shows_its_own() {
    let mut state = state();
    for (tab, words) in [
        (Tab::Signals, &["Force [N]", "Screw displacement [mm]"][..]),
        (
            Tab::Parameters,
            &["Effective inertance 95.11 ± 0.48 kg", "Viscous friction: not identifiable", "Backlash 50.0 ± 1.2 µm"],
        ),
        (
            Tab::Health,
            &[
                "Samples saturated                    3",
                "Processor load                       34.5 %",
                "page: http://127.0.0.1:1/",
            ],
        ),
        (Tab::Events, &["8.00 s  marker: bolt tightened"]),
    ] {
        state.tab = tab;
        let screen = drawn(&state, 80, 24, true).0.join("\n");
        for word in words {
            assert!(screen.contains(word), "{tab:?} without {word}:\n{screen}");
        }
    }
}

#[test]
fn no_terminal_is_too_small_and_none_too_large() {
    let mut state = state();
    let empty = State::default();
    for (width, height) in [(0, 0), (1, 1), (10, 3), (40, 10), (79, 23), (300, 100)] {
        for (tab, _) in Tab::ALL {
            for prompt in [Prompt::None, Prompt::Help, Prompt::Marker("text".into()), Prompt::Reset] {
                (state.tab, state.prompt) = (tab, prompt);
                drawn(&state, width, height, true);
            }
            drawn(&State { tab, ..empty.clone() }, width, height, true);
        }
    }
    (state.tab, state.prompt) = (Tab::Overview, Prompt::None);
    let screen = drawn(&state, 40, 10, true).0.join("\n");
    assert!(screen.contains("Effective inertance") & screen.contains("95.11"), "{screen}");
}

#[test]
fn without_colours_nothing_is_coloured_and_all_is_said() {
    let mut state = state();
    for (tab, _) in Tab::ALL {
        state.tab = tab;
        let (plain, coloured) = drawn(&state, 100, 40, false);
        assert!(!coloured, "{tab:?}");
        assert_eq!(plain, drawn(&state, 100, 40, true).0, "{tab:?}");
    }
    state.tab = Tab::Overview;
    assert!(drawn(&state, 100, 40, true).1);
}

#[test]
fn a_pause_and_a_device_that_is_away_are_said_first() {
    let mut state = state();
    state.paused = Some((5.0, state.values));
    assert!(drawn(&state, 80, 24, true).0[0].starts_with(" PAUSED "));
    state.paused = None;
    state.item(&Item::Away { reason: "COM3 went away; waiting 10 s for it to come back".into() });
    assert!(drawn(&state, 80, 24, true).0[0].starts_with("COM3 went away; waiting 10 s"));
}

#[test]
fn what_is_no_number_is_not_identifiable_on_the_screen() {
    let mut state = state();
    let nan = Parameter::Ok(Interval { value: f32::NAN, u95: 1.0 });
    let parameters = Parameters { inertance_kg: nan, viscous_n_s_per_m: nan, coulomb_n: nan, offset_n: nan };
    let estimate = Estimate {
        recent: parameters,
        whole_run: parameters,
        moving: true,
        residual_rms_n: f32::NAN,
        ..Estimate::default()
    };
    let size = BacklashSize::Ok(Interval { value: f32::NAN, u95: f32::NAN });
    let detail = Some(Detail { backlash: Backlash { size, ..Backlash::default() }, ..Detail::default() });
    let estimated = Estimated { estimate, law: None, detail };
    state.item(&Item::Estimate { at: at(11.0), t_s: 11.0, estimated });
    let screen = drawn(&state, 120, 40, true).0.join("\n");
    assert!(!screen.contains("NaN") && screen.contains("residual unknown"), "{screen}");
    let row = |label| screen.lines().find(|line| line.contains(label)).unwrap();
    for label in ["Effective inertance", "Viscous friction", "Coulomb friction", "Force offset", "Backlash"] {
        let row = row(label);
        assert!(row.contains("not identifiable") && !row.contains(" ok "), "{screen}");
    }
}

#[test]
fn no_text_from_outside_is_drawn_as_it_came() {
    let mut state = state();
    (state.recording, state.elsewhere) = (Some(WORDS.into()), vec![WORDS.into()]);
    for item in monitored(state.settings, at(10.0)) {
        state.item(&item);
    }
    state.prompt = Prompt::Marker(WORDS.into());
    let name = printable(&Hello::text::<24>(WORDS)).into_owned();
    for (tab, _) in Tab::ALL {
        state.tab = tab;
        let lines = drawn(&state, 400, 40, true).0;
        for line in &lines {
            assert_eq!(printable(line), line.as_str(), "{tab:?}");
        }
        let shown =
            |from: usize, to: usize| lines[from..to].iter().map(|line| line.matches(SHOWN).count()).sum::<usize>();
        // Why the device is away, the recording, and the port.
        assert_eq!(shown(0, 1), 3, "{tab:?}: {}", lines[0]);
        assert!(lines[0].contains(&format!("{name} {name}")), "{tab:?}: {}", lines[0]);
        let expected = match tab {
            Tab::Overview | Tab::Health => 1,
            Tab::Signals | Tab::Parameters => 0,
            Tab::Events => 5,
        };
        assert_eq!(shown(2, 39), expected, "{tab:?}: {}", lines.join("\n"));
        assert_eq!(shown(39, 40), 1, "{tab:?}: {}", lines[39]);
        let firmware = printable(&Hello::text::<32>(WORDS)).into_owned();
        let is_named = lines.iter().any(|line| line.contains(&format!("{firmware}, {name}, clock")));
        assert_eq!(is_named, tab == Tab::Health, "{}", lines.join("\n"));
    }
}
