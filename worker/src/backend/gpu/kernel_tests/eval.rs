//! Asks a kernel's own functions: those of whole numbers, bits and places, on the CPU, as naga has parsed them.

use naga::{
    BinaryOperator, Block, Expression, Function, Handle, Literal, LocalVariable, MathFunction, Module,
    ScalarKind, Statement, SwizzleComponent, TypeInner, UnaryOperator,
};
use std::collections::HashMap;

/// A value of the text. Pointers stand for what they point to; only whole local variables are written.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    U(u32),
    F(f32),
    B(bool),
    /// A vector, an array or a struct.
    Many(Vec<Value>),
}

impl Value {
    /// All words of it, one after the other.
    pub(super) fn words(&self) -> Vec<u32> {
        match self {
            Self::U(v) => vec![*v],
            Self::F(v) => vec![v.to_bits()],
            Self::B(v) => vec![u32::from(*v)],
            Self::Many(values) => values.iter().flat_map(Self::words).collect(),
        }
    }

    pub(super) fn pair([x, y]: [u32; 2]) -> Self {
        Self::Many(vec![Self::U(x), Self::U(y)])
    }
}

/// A module, what `word` reads, and what `scene` says.
pub(super) struct Machine<'a> {
    pub(super) module: &'a Module,
    pub(super) word: &'a dyn Fn(u32) -> u32,
    pub(super) scene: &'a dyn Fn(&str) -> u32,
}

/// How a block ended.
enum Flow {
    On,
    Break,
    Continue,
    Return(Value),
}

/// A call of a function.
struct Call<'a> {
    function: &'a Function,
    arguments: Vec<Value>,
    locals: HashMap<Handle<LocalVariable>, Value>,
    known: HashMap<Handle<Expression>, Value>,
}

impl Machine<'_> {
    /// What the function of that name answers.
    pub(super) fn call(&self, name: &str, arguments: Vec<Value>) -> Value {
        let [Value::U(at)] = arguments[..] else { return self.run(name, arguments) };
        if name == "word" { Value::U((self.word)(at)) } else { self.run(name, arguments) }
    }

    fn run(&self, name: &str, arguments: Vec<Value>) -> Value {
        let mut functions = self.module.functions.iter();
        let found = functions.find(|(_, function)| function.name.as_deref() == Some(name));
        let (_, function) = found.unwrap_or_else(|| panic!("the text has no function {name}"));
        let mut call = Call { function, arguments, locals: HashMap::new(), known: HashMap::new() };
        for (handle, local) in function.local_variables.iter() {
            if let Some(init) = local.init {
                let value = self.value(&call, init);
                call.locals.insert(handle, value);
            }
        }
        match self.block(&mut call, &function.body) {
            Flow::Return(value) => value,
            _ => panic!("{name} returns nothing"),
        }
    }

    fn block(&self, call: &mut Call<'_>, block: &Block) -> Flow {
        for statement in block {
            let flow = match statement {
                Statement::Emit(range) => {
                    for handle in range.clone() {
                        // What was known of it, in the round of a loop before, is so no more.
                        call.known.remove(&handle);
                        let value = self.value(call, handle);
                        call.known.insert(handle, value);
                    }
                    Flow::On
                }
                Statement::Block(block) => self.block(call, block),
                Statement::If { condition, accept, reject } => match self.value(call, *condition) {
                    Value::B(true) => self.block(call, accept),
                    _ => self.block(call, reject),
                },
                Statement::Loop { body, continuing, break_if: None } => loop {
                    match self.block(call, body) {
                        Flow::Break => break Flow::On,
                        Flow::Return(value) => break Flow::Return(value),
                        Flow::On | Flow::Continue => self.block(call, continuing),
                    };
                },
                Statement::Break => Flow::Break,
                Statement::Continue => Flow::Continue,
                Statement::Return { value: Some(value) } => Flow::Return(self.value(call, *value)),
                Statement::Store { pointer, value } => {
                    let Expression::LocalVariable(local) = call.function.expressions[*pointer] else {
                        panic!("a part of a variable is written");
                    };
                    let value = self.value(call, *value);
                    call.locals.insert(local, value);
                    Flow::On
                }
                Statement::Call { function, arguments, result } => {
                    let arguments = arguments.iter().map(|&argument| self.value(call, argument)).collect();
                    let name = self.module.functions[*function].name.as_deref().expect("a name");
                    let value = self.call(name, arguments);
                    call.known.extend(result.map(|result| (result, value)));
                    Flow::On
                }
                other => panic!("not a statement of whole numbers: {other:?}"),
            };
            if !matches!(flow, Flow::On) {
                return flow;
            }
        }
        Flow::On
    }

    fn value(&self, call: &Call<'_>, handle: Handle<Expression>) -> Value {
        if let Some(value) = call.known.get(&handle) {
            return value.clone();
        }
        let of = |handle: Handle<Expression>| self.value(call, handle);
        match &call.function.expressions[handle] {
            Expression::FunctionArgument(index) => call.arguments[*index as usize].clone(),
            Expression::LocalVariable(local) => call.locals[local].clone(),
            Expression::GlobalVariable(global) => self.global(*global),
            Expression::Load { pointer } => of(*pointer),
            Expression::AccessIndex { base, index } => match of(*base) {
                Value::Many(values) => values[*index as usize].clone(),
                other => panic!("{other:?} has no parts"),
            },
            Expression::Compose { ty, components } => {
                self.compose(*ty, components.iter().map(|&part| of(part)).collect())
            }
            Expression::Splat { size, value } => Value::Many(vec![of(*value); *size as usize]),
            Expression::Swizzle { size, vector, pattern } => match of(*vector) {
                Value::Many(values) => {
                    let pattern = pattern.iter().take(*size as usize);
                    let at = |part: &SwizzleComponent| values[*part as usize].clone();
                    Value::Many(pattern.map(at).collect())
                }
                other => panic!("{other:?} is no vector"),
            },
            Expression::Binary { op, left, right } => binary(*op, &of(*left), &of(*right)),
            Expression::Unary { op: UnaryOperator::LogicalNot, expr } => match of(*expr) {
                Value::B(v) => Value::B(!v),
                other => panic!("{other:?} is no bool"),
            },
            Expression::Select { condition, accept, reject } => match of(*condition) {
                Value::B(true) => of(*accept),
                _ => of(*reject),
            },
            Expression::As { expr, kind, convert } => cast(&of(*expr), *kind, convert.is_some()),
            Expression::Math { fun, arg, .. } => match (fun, of(*arg)) {
                (MathFunction::CountLeadingZeros, Value::U(v)) => Value::U(v.leading_zeros()),
                (MathFunction::ReverseBits, Value::U(v)) => Value::U(v.reverse_bits()),
                (fun, other) => panic!("{fun:?} of {other:?}"),
            },
            constant => self.constant(constant),
        }
    }

    fn global(&self, handle: Handle<naga::GlobalVariable>) -> Value {
        let variable = &self.module.global_variables[handle];
        match (variable.name.as_deref(), &self.module.types[variable.ty].inner) {
            (Some("scene"), TypeInner::Struct { members, .. }) => {
                let said = |member: &naga::StructMember| {
                    Value::U((self.scene)(member.name.as_deref().expect("a name")))
                };
                Value::Many(members.iter().map(said).collect())
            }
            // Of these the host alone knows that they are 0.
            (Some("zero"), _) => Value::U(0),
            (name, _) => panic!("{name:?} is not known here"),
        }
    }

    /// An expression of literals and constants.
    pub(super) fn constant(&self, expression: &Expression) -> Value {
        let of = |handle: &Handle<Expression>| self.constant(&self.module.global_expressions[*handle]);
        match expression {
            Expression::Literal(Literal::U32(v)) => Value::U(*v),
            Expression::Literal(Literal::I32(v)) => Value::U(v.cast_unsigned()),
            Expression::Literal(Literal::F32(v)) => Value::F(*v),
            Expression::Literal(Literal::Bool(v)) => Value::B(*v),
            Expression::Constant(constant) => of(&self.module.constants[*constant].init),
            Expression::Compose { ty, components } => self.compose(*ty, components.iter().map(of).collect()),
            other => panic!("not an expression of whole numbers: {other:?}"),
        }
    }

    /// Vectors may be made of vectors; structs keep theirs.
    fn compose(&self, ty: Handle<naga::Type>, values: Vec<Value>) -> Value {
        if !matches!(self.module.types[ty].inner, TypeInner::Vector { .. }) {
            return Value::Many(values);
        }
        let parts = values.into_iter().flat_map(|value| match value {
            Value::Many(values) => values,
            one => vec![one],
        });
        Value::Many(parts.collect())
    }
}

fn binary(op: BinaryOperator, left: &Value, right: &Value) -> Value {
    use BinaryOperator as Op;
    match (left, right) {
        (Value::Many(left), Value::Many(right)) => {
            Value::Many(left.iter().zip(right).map(|(left, right)| binary(op, left, right)).collect())
        }
        (Value::Many(left), right) => Value::Many(left.iter().map(|left| binary(op, left, right)).collect()),
        (Value::U(a), Value::U(b)) => match op {
            Op::Add => Value::U(a.wrapping_add(*b)),
            Op::Subtract => Value::U(a.wrapping_sub(*b)),
            Op::Multiply => Value::U(a.wrapping_mul(*b)),
            Op::Divide => Value::U(a / b),
            Op::Modulo => Value::U(a % b),
            Op::And => Value::U(a & b),
            Op::InclusiveOr => Value::U(a | b),
            Op::ExclusiveOr => Value::U(a ^ b),
            Op::ShiftLeft => Value::U(a << (b & 31)),
            Op::ShiftRight => Value::U(a >> (b & 31)),
            Op::Equal => Value::B(a == b),
            Op::NotEqual => Value::B(a != b),
            Op::Less => Value::B(a < b),
            Op::LessEqual => Value::B(a <= b),
            Op::Greater => Value::B(a > b),
            Op::GreaterEqual => Value::B(a >= b),
            _ => panic!("{op:?} of words"),
        },
        (Value::F(a), Value::F(b)) if op == Op::Multiply => Value::F(a * b),
        _ => panic!("{op:?} of {left:?} and {right:?}"),
    }
}

fn cast(value: &Value, kind: ScalarKind, converts: bool) -> Value {
    match (value, kind, converts) {
        (Value::Many(values), ..) => Value::Many(values.iter().map(|v| cast(v, kind, converts)).collect()),
        (Value::U(v), ScalarKind::Float, false) => Value::F(f32::from_bits(*v)),
        (Value::U(v), ScalarKind::Float, true) => Value::F(*v as f32),
        (Value::F(v), ScalarKind::Uint | ScalarKind::Sint, false) => Value::U(v.to_bits()),
        (Value::U(v), ScalarKind::Uint | ScalarKind::Sint, _) => Value::U(*v),
        _ => panic!("{value:?} as {kind:?}"),
    }
}
