//! What a PLY header says, as data: encodings, scalar types, properties, elements.
//!
//! A few hundred bytes whatever the mesh; nothing here touches the payload.

/// How the payload is written.
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

/// What a property holds for a record.
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
    /// Bytes of a record's value in a binary payload, at the least.
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
    /// How many records the header promises.
    pub count: usize,
    /// The columns, in file order.
    pub properties: Vec<Property>,
}

impl Element {
    /// Bytes of a record in a binary payload at the least: exact where no property is a list.
    pub fn least_size(&self) -> usize {
        self.properties.iter().map(|property| property.kind.least_size()).sum()
    }

    /// Bytes of every record in a binary payload; `None` where a property is a list.
    pub fn fixed_size(&self) -> Option<usize> {
        let lists = self.properties.iter().any(|property| matches!(property.kind, Kind::List { .. }));
        (!lists).then(|| self.least_size())
    }

    /// Where the property called `name` stands.
    pub fn find(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name)
    }

    /// Whether the element is called `name`, in any case.
    pub fn is(&self, name: &str) -> bool {
        self.name.eq_ignore_ascii_case(name)
    }
}
