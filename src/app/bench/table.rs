//! Figures as a Markdown table or as JSON lines.

use crate::app::say;
use serde_json::{Map, Value};

/// A column: its title, its name in JSON, and the decimals of its numbers.
pub struct Column(pub &'static str, pub &'static str, pub usize);

/// What stands in a column.
pub enum Cell {
    /// A word.
    Word(String),
    /// A number; what is not finite is printed as `-` and is null in JSON.
    Number(f64),
}

impl From<&str> for Cell {
    fn from(word: &str) -> Self {
        Cell::Word(word.into())
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Cell::Number(number)
    }
}

impl From<usize> for Cell {
    fn from(number: usize) -> Self {
        Cell::Number(number as f64)
    }
}

/// The figures of one part.
pub struct Table {
    /// Its name: the field `part` in JSON.
    pub part: &'static str,
    /// What was measured, one line.
    pub about: String,
    /// Its columns.
    pub columns: &'static [Column],
    /// A cell a column.
    pub rows: Vec<Vec<Cell>>,
}

impl Table {
    /// Prints it.
    pub fn print(&self, json: bool) -> anyhow::Result<()> {
        if json {
            return self.rows.iter().try_for_each(|row| say(Value::Object(self.object(row))));
        }
        say(format_args!("\n{}: {}\n\n{}", self.part, self.about, self.markdown()))
    }

    fn object(&self, row: &[Cell]) -> Map<String, Value> {
        let mut object = Map::from_iter([("part".into(), self.part.into())]);
        for (Column(_, name, decimals), cell) in self.columns.iter().zip(row) {
            let value = match cell {
                Cell::Word(word) => word.as_str().into(),
                // counts without a decimal point
                Cell::Number(number) if *decimals == 0 && number.is_finite() => (*number as i64).into(),
                Cell::Number(number) => (*number).into(),
            };
            object.insert((*name).into(), value);
        }
        object
    }

    fn markdown(&self) -> String {
        let text = |(Column(_, _, decimals), cell): (&Column, &Cell)| match cell {
            Cell::Word(word) => word.clone(),
            Cell::Number(number) if number.is_finite() => format!("{number:.decimals$}"),
            Cell::Number(_) => "-".into(),
        };
        let mut lines = vec![self.columns.iter().map(|column| column.0.to_string()).collect::<Vec<_>>()];
        lines.extend(self.rows.iter().map(|row| self.columns.iter().zip(row).map(text).collect()));
        let width = |i: usize| lines.iter().map(|line| line[i].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        lines.insert(1, widths.iter().map(|width| "-".repeat(*width)).collect());
        let line = |cells: &Vec<String>| {
            let padded = cells.iter().zip(&widths).map(|(cell, &width)| format!("{cell:<width$}"));
            format!("| {} |", padded.collect::<Vec<_>>().join(" | "))
        };
        lines.iter().map(line).collect::<Vec<_>>().join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_say_the_same() {
        let table = Table {
            part: "speed",
            about: "ms".into(),
            columns: &[Column("what", "what", 0), Column("n", "count", 0), Column("ms", "ms", 2)],
            rows: vec![
                vec!["noisy".into(), 3usize.into(), 0.256.into()],
                vec!["σ".into(), 0usize.into(), f64::NAN.into()],
            ],
        };
        let lines =
            ["| what  | n | ms   |", "| ----- | - | ---- |", "| noisy | 3 | 0.26 |", "| σ     | 0 | -    |"];
        assert_eq!(table.markdown(), lines.join("\n"));
        let json = |row: &Vec<Cell>| Value::Object(table.object(row));
        let first = serde_json::json!({ "part": "speed", "what": "noisy", "count": 3, "ms": 0.256 });
        assert_eq!(json(&table.rows[0]), first);
        assert_eq!(json(&table.rows[1])["ms"], Value::Null);
    }
}
