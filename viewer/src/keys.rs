//! What keys do, for the interface and for its list of keys.

use eframe::egui::{Key, Modifiers};

use crate::action::Action;
use crate::picture::Picture;

/// A key and what it does.
#[derive(Clone, Debug)]
pub struct Binding {
    /// Keys held with it.
    pub modifiers: Modifiers,
    /// The key.
    pub key: Key,
    /// What it does, in words; empty where the one before says it.
    pub does: &'static str,
    /// What it does.
    pub action: Action,
}

/// All keys.
pub fn bindings() -> Vec<Binding> {
    const NONE: Modifiers = Modifiers::NONE;
    const SHIFT: Modifiers = Modifiers::SHIFT;
    const CTRL: Modifiers = Modifiers::COMMAND;
    const PAN: f32 = 40.0;
    let mut bindings = Vec::new();
    let mut bind = |modifiers, key, does, action| bindings.push(Binding { modifiers, key, does, action });
    bind(NONE, Key::Space, "play or pause", Action::Play);
    bind(NONE, Key::ArrowRight, "one frame on", Action::Step(1));
    bind(NONE, Key::ArrowLeft, "one frame back", Action::Step(-1));
    bind(SHIFT, Key::ArrowRight, "ten frames on", Action::Step(10));
    bind(SHIFT, Key::ArrowLeft, "ten frames back", Action::Step(-10));
    bind(NONE, Key::Home, "first frame (live: oldest in memory)", Action::First);
    bind(NONE, Key::End, "last frame (live: newest)", Action::Last);
    bind(NONE, Key::ArrowUp, "faster", Action::Faster);
    bind(NONE, Key::ArrowDown, "slower", Action::Slower);
    bind(NONE, Key::L, "begin again at the end, or not", Action::Loop);
    bind(NONE, Key::E, "half a stop brighter", Action::Expose(0.5));
    bind(SHIFT, Key::E, "half a stop darker", Action::Expose(-0.5));
    bind(NONE, Key::T, "next tone curve", Action::NextCurve);
    bind(NONE, Key::C, "mark clipped pixels", Action::Clipping);
    bind(NONE, Key::G, "dithering", Action::Dither);
    bind(NONE, Key::D, "difference pictures: finer", Action::WidenDifference(0.5));
    bind(SHIFT, Key::D, "coarser", Action::WidenDifference(2.0));
    bind(NONE, Key::V, "next arrangement of panes", Action::NextArrangement);
    bind(NONE, Key::N, "choose the next pane", Action::NextPane);
    let numbers = [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7];
    for (i, (key, picture)) in numbers.into_iter().zip(Picture::ALL).enumerate() {
        let does = if i == 0 { "1 to 7: show this in the chosen pane" } else { "" };
        bind(NONE, key, does, Action::ShowHere(picture));
    }
    bind(NONE, Key::OpenBracket, "divider to the left", Action::MoveDivider(-0.02));
    bind(NONE, Key::CloseBracket, "divider to the right", Action::MoveDivider(0.02));
    bind(NONE, Key::F, "fit pictures into their panes", Action::Fit);
    bind(NONE, Key::A, "actual size", Action::Actual);
    bind(NONE, Key::Plus, "zoom in", Action::Zoom(1.25, None));
    bind(NONE, Key::Equals, "", Action::Zoom(1.25, None));
    bind(NONE, Key::Minus, "zoom out", Action::Zoom(0.8, None));
    bind(CTRL, Key::ArrowLeft, "with all arrows: pan", Action::Pan([PAN, 0.0]));
    bind(CTRL, Key::ArrowRight, "", Action::Pan([-PAN, 0.0]));
    bind(CTRL, Key::ArrowUp, "", Action::Pan([0.0, PAN]));
    bind(CTRL, Key::ArrowDown, "", Action::Pan([0.0, -PAN]));
    bind(NONE, Key::X, "time series of the pixel under the pointer", Action::PickHere);
    bind(SHIFT, Key::X, "forget all picked pixels", Action::Unpick);
    bind(NONE, Key::P, "time series", Action::Series);
    bind(NONE, Key::K, "dials", Action::Dials);
    bind(NONE, Key::W, "next net", Action::NextNet);
    bind(NONE, Key::U, "next executor", Action::NextExecutor);
    bind(NONE, Key::Y, "next precision", Action::NextPrecision);
    bind(NONE, Key::Z, "next mode of skipping", Action::NextSkip);
    bind(
        NONE,
        Key::Period,
        "bounded skipping: allow more error",
        Action::AllowMore(std::f64::consts::SQRT_2),
    );
    bind(NONE, Key::Comma, "allow less", Action::AllowMore(std::f64::consts::FRAC_1_SQRT_2));
    bind(NONE, Key::M, "mark computed cells", Action::Overlay);
    bind(NONE, Key::S, "save the chosen pane's frame as EXR", Action::SaveExr);
    bind(SHIFT, Key::S, "save the chosen pane as PNG", Action::SavePng);
    bind(NONE, Key::I, "the range begins here", Action::RangeFrom);
    bind(NONE, Key::O, "the range ends here", Action::RangeTo);
    bind(SHIFT, Key::O, "the range is all of memory", Action::NoRange);
    bind(NONE, Key::R, "record the range", Action::Record);
    bind(NONE, Key::B, "light, dark, or as the system", Action::NextTheme);
    bind(NONE, Key::H, "this list", Action::Help);
    bind(NONE, Key::F1, "", Action::Help);
    bind(CTRL, Key::O, "type a source", Action::Type);
    bind(CTRL, Key::Q, "quit", Action::Quit);
    bindings
}

impl Binding {
    /// The key in words.
    pub fn name(&self) -> String {
        let mut name = String::new();
        if self.modifiers.command {
            name += "Ctrl ";
        }
        if self.modifiers.shift {
            name += "Shift ";
        }
        // The symbols of arrows are in no font.
        let arrow = matches!(self.key, Key::ArrowLeft | Key::ArrowRight | Key::ArrowUp | Key::ArrowDown);
        name + if arrow { self.key.name() } else { self.key.symbol_or_name() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_does_two_things() {
        let bindings = bindings();
        for (i, a) in bindings.iter().enumerate() {
            assert!(
                bindings[..i].iter().all(|b| (a.modifiers, a.key) != (b.modifiers, b.key)),
                "{}",
                a.name()
            );
        }
    }
}
