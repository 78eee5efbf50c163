//! Tables for people, as text or as Markdown.

/// A table: the first column is set to the left, all others to the right.
#[derive(Debug, Default)]
pub struct Table {
    rows: Vec<Vec<String>>,
}

/// A figure with some digits behind the point; a dash for none.
pub fn figure(value: Option<f64>, digits: usize) -> String {
    value.filter(|value| value.is_finite()).map_or_else(|| "–".into(), |value| format!("{value:.digits$}"))
}

/// A figure with about three digits, for what can be small or large.
pub fn short(value: f64) -> String {
    let digits = 2 - value.abs().max(1e-9).log10().floor().clamp(-4.0, 2.0) as i32;
    figure(Some(value), digits as usize)
}

impl Table {
    /// A table with nothing but its headings, which name quantity and unit.
    pub fn new(headings: &[&str]) -> Self {
        Self { rows: vec![headings.iter().map(|&heading| heading.to_owned()).collect()] }
    }

    /// Adds a row.
    pub fn row(&mut self, cells: Vec<String>) {
        self.rows.push(cells);
    }

    fn widths(&self) -> Vec<usize> {
        let columns = self.rows.iter().map(Vec::len).max().unwrap_or(0);
        let len = |cell: Option<&String>| cell.map_or(0, |cell| cell.chars().count());
        let width = |column| self.rows.iter().map(|row| len(row.get(column))).max();
        (0..columns).map(|column| width(column).unwrap_or(0)).collect()
    }

    /// The table, its lines without an end of the last one.
    pub fn text(&self, markdown: bool) -> String {
        let widths = self.widths();
        let separator = if markdown { " | " } else { "  " };
        let line = |row: &Vec<String>| {
            let cells = row.iter().zip(&widths).enumerate();
            let cells = cells.map(|(column, (cell, &width))| match column {
                0 => format!("{cell:<width$}"),
                _ => format!("{cell:>width$}"),
            });
            let line = cells.collect::<Vec<_>>().join(separator);
            if markdown { format!("| {line} |") } else { line.trim_end().to_owned() }
        };
        let mut lines: Vec<String> = self.rows.iter().map(line).collect();
        if markdown {
            let rule = |(column, _): (usize, &usize)| if column == 0 { "|---" } else { "|--:" };
            lines.insert(1, widths.iter().enumerate().map(rule).collect::<String>() + "|");
        }
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_aligned() {
        let mut table = Table::new(&["net", "ms", "µ"]);
        table.row(vec!["fast".into(), figure(Some(1.5), 1), figure(None, 1)]);
        table.row(vec!["a".into(), short(12.345), short(0.001_234)]);
        assert_eq!(table.text(false), "net     ms        µ\nfast   1.5        –\na     12.3  0.00123");
        let markdown = table.text(true);
        let lines: Vec<&str> = markdown.lines().collect();
        assert_eq!(lines[1], "|---|--:|--:|");
        assert_eq!(lines[2], "| fast |  1.5 |       – |");
    }

    #[test]
    fn short_figures_have_three_digits() {
        assert_eq!(
            [1234.5, 99.0, 1.0, 0.05, 0.0, f64::NAN].map(short),
            ["1234", "99.0", "1.00", "0.0500", "0.000000", "–"]
        );
    }
}
