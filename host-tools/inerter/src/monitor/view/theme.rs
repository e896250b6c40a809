//! Colours of the screen.

use ratatui::{
    style::{Color, Modifier, Style},
    text::Line,
    widgets::Block,
};

/// Colours, or only the attributes that every terminal supports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Theme {
    /// Whether colours may be used (`NO_COLOR` is not set).
    pub colour: bool,
}

impl Theme {
    pub fn coloured(self, colour: Color) -> Style {
        if self.colour { Style::new().fg(colour) } else { Style::new() }
    }

    pub fn good(self) -> Style {
        self.coloured(Color::Green)
    }

    pub fn doubtful(self) -> Style {
        self.coloured(Color::Yellow)
    }

    pub fn bad(self) -> Style {
        self.coloured(Color::Red).add_modifier(Modifier::BOLD)
    }

    pub fn curve(self) -> Style {
        self.coloured(Color::Cyan)
    }

    pub fn band(self) -> Style {
        self.coloured(Color::Blue)
    }

    pub fn quiet(self) -> Style {
        if self.colour { Style::new().fg(Color::DarkGray) } else { Style::new().add_modifier(Modifier::DIM) }
    }

    pub fn title(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    pub fn block(self, title: impl Into<Line<'static>>) -> Block<'static> {
        Block::bordered().border_style(self.quiet()).title_style(self.title()).title(title.into())
    }
}
