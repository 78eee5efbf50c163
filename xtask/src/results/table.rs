//! Tables in Markdown, made from records.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Result;

/// How a table is made from a record.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(untagged)]
pub enum Table {
    /// Rows that stand in the record.
    Rows(Rows),
    /// A row for each element of an array in the figures.
    Each(Each),
    /// Quality by class of clip, a column for each method of `pix2hdr suite`.
    Classes(Classes),
}

/// Rows that stand in the record, one cell a column.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Rows {
    columns: Vec<Column>,
    rows: Vec<Vec<Value>>,
}

/// A row for each element of an array in the figures.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Each {
    /// Where the array is: a JSON pointer.
    each: String,
    columns: Vec<Column>,
}

/// Quality by class of clip.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Classes {
    methods: Vec<Method>,
}

/// A column of a table of classes.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Method {
    heading: String,
    /// What `pix2hdr suite` calls it.
    name: String,
    /// The record that has it, if it is another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    record: Option<String>,
}

/// A column and how its figures are written; text stays as it is, and nothing becomes a dash.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Column {
    heading: String,
    /// In a row of figures, where the figure is: a JSON pointer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    from: Option<String>,
    /// Where a figure is that is taken from it, for a difference: a JSON pointer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    minus: Option<String>,
    /// What a figure is multiplied with, for another unit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    times: Option<f64>,
    /// Digits behind the point. Without, integers stay integers and others get about three digits in all, as in what
    /// `pix2hdr bench` prints.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    digits: Option<usize>,
    /// Whether a figure above zero gets a plus.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    signed: bool,
}

impl Column {
    fn cell(&self, value: &Value) -> String {
        let text = match value {
            Value::Null => "–".into(),
            Value::String(text) => text.clone(),
            Value::Number(number) => {
                let integer = !number.is_f64() && self.times.is_none();
                let number = number.as_f64().unwrap_or(f64::NAN) * self.times.unwrap_or(1.0);
                let digits = self.digits.unwrap_or_else(|| if integer { 0 } else { short(number) });
                let plus = if self.signed && number > -0.5 * 0.1_f64.powi(digits as i32) { "+" } else { "" };
                format!("{plus}{number:.digits$}")
            }
            other => other.to_string(),
        };
        text.replace('|', "\\|")
    }
}

/// Digits behind the point for about three in all.
fn short(number: f64) -> usize {
    (2 - number.abs().max(1e-9).log10().floor().clamp(-4.0, 2.0) as i32) as usize
}

impl Table {
    /// The table in Markdown, every line with an end, from the `figures` of its record and those of `others`.
    pub fn markdown(&self, figures: &Value, others: &BTreeMap<&str, &Value>) -> Result<String> {
        match self {
            Self::Rows(Rows { columns, rows }) => {
                let cells = rows.iter().map(|row| {
                    if row.len() != columns.len() {
                        return Err(format!("a row of {} cells for {} columns", row.len(), columns.len()));
                    }
                    Ok(columns.iter().zip(row).map(|(column, value)| column.cell(value)).collect())
                });
                Ok(lines(headings(columns), cells.collect::<Result<_>>()?))
            }
            Self::Each(Each { each, columns }) => {
                let array = figures.pointer(each).and_then(Value::as_array);
                let array = array.ok_or_else(|| format!("no array at {each}"))?;
                let cells = array.iter().map(|row| {
                    let at = |at: &str| row.pointer(at).ok_or_else(|| format!("nothing at {each}/…{at}"));
                    let cell = |column: &Column| {
                        let value = at(column.from.as_ref().ok_or("a column without 'from'")?)?;
                        let Some(minus) = &column.minus else { return Ok(column.cell(value)) };
                        let number =
                            |value: &Value| value.as_f64().ok_or_else(|| format!("{value} is no number"));
                        Ok(column.cell(&Value::from(number(value)? - number(at(minus)?)?)))
                    };
                    columns.iter().map(cell).collect()
                });
                Ok(lines(headings(columns), cells.collect::<Result<_>>()?))
            }
            Self::Classes(classes) => classes.markdown(figures, others),
        }
    }
}

fn headings(columns: &[Column]) -> Vec<String> {
    columns.iter().map(|column| column.heading.clone()).collect()
}

/// The first column is set to the left, all others to the right.
fn lines(headings: Vec<String>, rows: Vec<Vec<String>>) -> String {
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let rule = format!("|---|{}\n", "--:|".repeat(headings.len().saturating_sub(1)));
    line(headings) + &rule + &rows.into_iter().map(line).collect::<String>()
}

/// Classes of the suite: speed and light of a clip, and what they are called.
const SPEEDS: [(&str, &str); 5] = [
    ("static", "static"),
    ("slow", "slow (≤ 0.25 px/frame)"),
    ("medium", "medium (≤ 1)"),
    ("fast", "fast (≤ 2)"),
    ("extreme", "extreme (≤ 4)"),
];
const LIGHTS: [(&str, &str); 2] = [("normal", "normal light"), ("low", "low light")];

impl Classes {
    fn markdown(&self, figures: &Value, others: &BTreeMap<&str, &Value>) -> Result<String> {
        let scores = self.methods.iter().map(|method| {
            let from = match &method.record {
                None => figures,
                Some(name) => others.get(name.as_str()).ok_or_else(|| format!("no record {name}"))?,
            };
            let of = |name: &str| from.pointer(&format!("/methods/{name}"));
            let missing = || format!("no method {}", method.name);
            Ok((of(&method.name).ok_or_else(missing)?, of("box").ok_or("no box filter")?))
        });
        let scores: Vec<(&Value, &Value)> = scores.collect::<Result<_>>()?;
        let mut rows = Vec::new();
        let mut row = |heading: String, digits: usize, margin: bool, of: &dyn Fn(&Value) -> Option<f64>| {
            let mut cells = vec![heading.clone()];
            for (method, reference) in &scores {
                let value = of(method).ok_or_else(|| format!("no figure for {heading}"))?;
                let over = of(reference).map_or(0.0, |reference| value - reference);
                let itself = std::ptr::eq(*method, *reference);
                let over = if margin && !itself { format!(" ({over:+.2})") } else { String::new() };
                cells.push(format!("{value:.digits$}{over}"));
            }
            rows.push(cells);
            Ok::<_, String>(())
        };
        row("**overall**".into(), 2, true, &|scores| scores.pointer("/overall/psnr_mu")?.as_f64())?;
        for (speed, speed_name) in SPEEDS {
            for (light, light_name) in LIGHTS {
                // Over what moves: camera, objects, both. There are as many clips of each.
                let mean = |scores: &Value| {
                    let classes = scores.get("classes")?.as_object()?.iter();
                    let these = classes.filter(|(name, _)| name.starts_with(speed) && name.ends_with(light));
                    let values: Option<Vec<f64>> =
                        these.map(|(_, score)| score.get("psnr_mu")?.as_f64()).collect();
                    values.filter(|all| !all.is_empty()).map(|all| all.iter().sum::<f64>() / all.len() as f64)
                };
                row(format!("{speed_name}, {light_name}"), 2, true, &mean)?;
            }
        }
        row("SSIM".into(), 4, false, &|scores| scores.pointer("/overall/ssim_mu")?.as_f64())?;
        row("PSNR of irradiance".into(), 2, true, &|scores| scores.pointer("/overall/psnr")?.as_f64())?;
        let names = self.methods.iter().map(|method| method.heading.clone());
        Ok(lines(std::iter::once(String::new()).chain(names).collect(), rows))
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn markdown(table: &Value, figures: &Value) -> Result<String> {
        let table: Table = serde_json::from_value(table.clone()).unwrap();
        table.markdown(figures, &BTreeMap::new())
    }

    #[test]
    fn rows_are_written_as_columns_say() {
        let table = json!({
            "columns": [
                {"heading": "net"}, {"heading": "ms"}, {"heading": "dB", "digits": 1},
                {"heading": "change", "digits": 2, "signed": true}
            ],
            "rows": [["fast", 1.654, 28, -0.5], ["a|b", 34, null, 0.004], ["x", 0.0953, "2–3", 1]],
        });
        assert_eq!(
            markdown(&table, &Value::Null).unwrap(),
            "| net | ms | dB | change |\n|---|--:|--:|--:|\n| fast | 1.65 | 28.0 | -0.50 |\n| a\\|b | 34 | – | +0.00 |\n\
             | x | 0.0953 | 2–3 | +1.00 |\n"
        );
        let short = json!({"columns": [{"heading": "a"}, {"heading": "b"}], "rows": [[1]]});
        assert!(markdown(&short, &Value::Null).unwrap_err().contains("1 cells for 2"));
    }

    #[test]
    fn figures_are_found_in_what_the_program_printed() {
        let table = json!({
            "each": "/rows",
            "columns": [{"heading": "net", "from": "/net"}, {"heading": "%", "from": "/of/part", "times": 100, "digits": 0},
                {"heading": "change", "from": "/of/part", "minus": "/of/whole", "digits": 1, "signed": true}],
        });
        let figures = json!({"rows": [{"net": "tiny", "of": {"part": 0.25, "whole": 1}}]});
        assert_eq!(
            markdown(&table, &figures).unwrap(),
            "| net | % | change |\n|---|--:|--:|\n| tiny | 25 | -0.8 |\n"
        );
        assert!(markdown(&table, &json!({"rows": [{"net": "tiny"}]})).unwrap_err().contains("/of/part"));
        assert!(markdown(&table, &json!({})).unwrap_err().contains("/rows"));
    }

    #[test]
    fn classes_are_means_over_what_moves() {
        let scores = |value: f64| {
            let mut classes = serde_json::Map::new();
            for (speed, _) in SPEEDS {
                for (i, moves) in ["pan", "object", "both"].iter().enumerate() {
                    for (light, _) in LIGHTS {
                        classes
                            .insert(format!("{speed}-{moves}-{light}"), json!({"psnr_mu": value + i as f64}));
                    }
                }
            }
            json!({"overall": {"psnr": value, "psnr_mu": value, "ssim_mu": 0.9}, "classes": classes})
        };
        let figures = json!({"methods": {"box": scores(30.0), "fast": scores(36.5)}});
        let table = json!({"methods": [
            {"heading": "box filter", "name": "box"}, {"heading": "`fast`", "name": "fast"}
        ]});
        let text = markdown(&table, &figures).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[..2], ["|  | box filter | `fast` |", "|---|--:|--:|"]);
        assert_eq!(lines[2], "| **overall** | 30.00 | 36.50 (+6.50) |");
        assert_eq!(lines[3], "| static, normal light | 31.00 | 37.50 (+6.50) |");
        assert_eq!(lines[13], "| SSIM | 0.9000 | 0.9000 |");
        assert_eq!(lines.len(), 15);
        let other = json!({"methods": [{"heading": "", "name": "large"}]});
        assert!(markdown(&other, &figures).unwrap_err().contains("large"));
    }
}
