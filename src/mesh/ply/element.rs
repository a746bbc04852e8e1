//! What a PLY header declares: elements, their properties, and the types of numbers.
//!
//! [`Element`] also says where and how the coordinates of vertices are read, for the decoder and for plans. Cost: none
//! beyond the names.

/// The encoding of the payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// Numbers as text.
    Ascii,
    /// Packed numbers, little-endian.
    Little,
    /// Packed numbers, big-endian.
    Big,
}

impl Encoding {
    /// The word in a `format` line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Ascii => "ascii",
            Self::Little => "binary_little_endian",
            Self::Big => "binary_big_endian",
        }
    }
}

/// A number's type in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// `char`, `int8`
    I8,
    /// `uchar`, `uint8`
    U8,
    /// `short`, `int16`
    I16,
    /// `ushort`, `uint16`
    U16,
    /// `int`, `int32`
    I32,
    /// `uint`, `uint32`
    U32,
    /// `float`, `float32`
    F32,
    /// `double`, `float64`
    F64,
}

impl Scalar {
    /// Its word in a header.
    pub fn word(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// Bytes in a binary payload.
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Whether it is a floating-point type.
    pub fn is_real(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// The type for corner counts up to `most`: `uchar` if possible.
    pub fn counting(most: u64) -> Self {
        if most <= Self::U8.greatest() { Self::U8 } else { Self::U32 }
    }

    /// The type of the numbers of `vertices` vertices: that of other programs if they fit.
    pub fn numbering(vertices: u64) -> Self {
        if vertices <= 1 << 31 { Self::I32 } else { Self::U32 }
    }

    /// The coordinate type: 64 bits if `double`, else 32.
    pub fn coordinate(double: bool) -> Self {
        if double { Self::F64 } else { Self::F32 }
    }

    /// `value` without its fraction, clamped to the range of this type; 0 for NaN.
    pub fn saturated(self, value: f64) -> i64 {
        let greatest = self.greatest() as i64;
        let least = if matches!(self, Self::I8 | Self::I16 | Self::I32) { -greatest - 1 } else { 0 };
        (value as i64).clamp(least, greatest)
    }

    /// The greatest integer that the type holds.
    pub fn greatest(self) -> u64 {
        match self {
            Self::I8 => i8::MAX as u64,
            Self::U8 => u64::from(u8::MAX),
            Self::I16 => i16::MAX as u64,
            Self::U16 => u64::from(u16::MAX),
            Self::I32 => i32::MAX as u64,
            Self::U32 => u64::from(u32::MAX),
            Self::F32 => 1 << 24,
            Self::F64 => 1 << 53,
        }
    }
}

impl From<Scalar> for Kind {
    fn from(scalar: Scalar) -> Self {
        Self::One(scalar)
    }
}

/// The kind of value that a property has in each record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One number.
    One(Scalar),
    /// A count and that many numbers.
    List {
        /// Type of the count, an integer.
        count: Scalar,
        /// Type of the items.
        item: Scalar,
    },
}

impl Kind {
    /// The words of a `property` line between `property` and the name.
    pub fn words(self) -> String {
        match self {
            Self::One(scalar) => scalar.word().to_owned(),
            Self::List { count, item } => format!("list {} {}", count.word(), item.word()),
        }
    }

    /// Minimum size in bytes of a record's value in a binary payload.
    pub fn least_size(self) -> usize {
        match self {
            Self::One(scalar) => scalar.size(),
            Self::List { count, .. } => count.size(),
        }
    }
}

/// A property of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// Its name in the file.
    pub name: String,
    /// What it holds.
    pub kind: Kind,
}

/// An element: a table of records.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// Its name in the file.
    pub name: String,
    /// Number of records stated in the header.
    pub count: usize,
    /// The columns, in file order.
    pub properties: Vec<Property>,
}

impl Element {
    /// Minimum size in bytes of a record in a binary payload: exact if no property is a list.
    pub fn least_size(&self) -> usize {
        self.properties.iter().map(|property| property.kind.least_size()).sum()
    }

    /// Size in bytes of every record in a binary payload; `None` if a property is a list.
    pub fn fixed_size(&self) -> Option<usize> {
        let lists = self.properties.iter().any(|property| matches!(property.kind, Kind::List { .. }));
        (!lists).then(|| self.least_size())
    }

    /// Minimum size in bytes of all records.
    pub(in crate::mesh) fn least_bytes(&self, encoding: Encoding) -> u128 {
        match encoding {
            // A digit and a blank each; the last blank may be missing.
            Encoding::Ascii => (2 * self.properties.len() as u128 * self.count as u128).saturating_sub(1),
            _ => self.least_size() as u128 * self.count as u128,
        }
    }

    /// The index of the property called `name`.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name)
    }

    /// Whether the element is called `name`, ignoring case.
    pub fn is(&self, name: &str) -> bool {
        self.name.eq_ignore_ascii_case(name)
    }

    /// The indices of the properties x, y and z (or X, Y and Z); `None` unless all are there as single numbers.
    pub(in crate::mesh) fn axes(&self) -> Option<[usize; 3]> {
        let axis = |name: &str| {
            let found = self.find(name).or_else(|| self.find(&name.to_ascii_uppercase()));
            found.filter(|&number| matches!(self.properties[number].kind, Kind::One(_)))
        };
        Some([axis("x")?, axis("y")?, axis("z")?])
    }

    /// How the coordinates at `axes` are read from a payload in `encoding`.
    pub(in crate::mesh) fn coordinates(&self, axes: [usize; 3], encoding: Encoding) -> Coordinates {
        let kinds = axes.map(|axis| self.properties[axis].kind);
        let all = |scalar: Scalar| kinds == [Kind::One(scalar); 3];
        let stride =
            self.fixed_size().filter(|_| encoding == Encoding::Little && (all(Scalar::F32) || all(Scalar::F64)));
        let wide = [Scalar::F64, Scalar::I32, Scalar::U32].map(Kind::One);
        Coordinates { stride, double: kinds.iter().any(|kind| wide.contains(kind)) }
    }
}

/// How the coordinates of vertices are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::mesh) struct Coordinates {
    /// Bytes from one record to the next if coordinates are read in place; `None` if they are decoded.
    pub stride: Option<usize>,
    /// Whether they are, or are decoded to, numbers of 64 bits, as no fewer hold what the file has.
    pub double: bool,
}
