//! Resolves interface files to messages. A `.msg` file is one message; a `.srv` or `.action` file
//! is several.

use super::{Base, Count, Definition, DefinitionError, Field, Problem, Scalar, parse};
use crate::dialect::Dialect;
use crate::name::{InterfaceKind, TypeName};

/// Returns all messages that a file defines. `name` consists of the package, the kind, and the
/// file's name without its extension.
///
/// - ROS 2 service `S`: `S_Request`, `S_Response`, `S_Event`, and `S` itself, which contains one of
///   each. No node sends `S`; its hash is that of the service.
/// - ROS 2 action `A`: `A_Goal`, `A_Result`, `A_Feedback`, the services `A_SendGoal` and
///   `A_GetResult`, `A_FeedbackMessage`, and `A` itself.
/// - ROS 1 service `S`: `S_Request` and `S_Response`, which ROS 1 writes without `_`.
/// - ROS 1 action `A`, as `genaction` makes it: the plain messages `AGoal`, `AResult` and
///   `AFeedback`, each also with `Action` in its name, and `AAction`.
///
/// # Errors
/// If a definition is invalid. The error names the type and the line, and suggests a correction.
pub fn definitions(dialect: Dialect, name: &TypeName, text: &str) -> Result<Vec<Definition>, DefinitionError> {
    if name.kind() == InterfaceKind::Message {
        return Ok(vec![parse(dialect, name, text, 1)?]);
    }
    let parts = parts(name, text)?;
    let names = match (name.kind(), dialect) {
        (InterfaceKind::Service, _) => {
            ["_Request", "_Response", ""].map(|suffix| name.with(InterfaceKind::Service, suffix))
        }
        (_, Dialect::Ros2) => ["_Goal", "_Result", "_Feedback"].map(|suffix| name.with(InterfaceKind::Action, suffix)),
        (_, Dialect::Ros1) => ["Goal", "Result", "Feedback"].map(|suffix| name.with(InterfaceKind::Message, suffix)),
    };
    let mut all = Vec::new();
    for ((first_line, part), name) in parts.iter().zip(&names) {
        all.push(parse(dialect, name, part, *first_line)?);
    }
    match (name.kind(), dialect) {
        (InterfaceKind::Service, Dialect::Ros1) => {}
        (InterfaceKind::Service, Dialect::Ros2) => all.extend(service(name)),
        (_, Dialect::Ros2) => all.extend(action(name)),
        (_, Dialect::Ros1) => all.extend(ros1_action(name)),
    }
    Ok(all)
}

/// Splits a text at lines of `---`. Returns each part with the number of its first line.
fn parts<'a>(name: &TypeName, text: &'a str) -> Result<Vec<(usize, &'a str)>, DefinitionError> {
    let mut parts = vec![];
    let (mut first, mut from, mut at) = (1, 0, 0);
    for (index, line) in text.split_inclusive('\n').enumerate() {
        if line.trim() == "---" {
            parts.push((first, &text[from..at]));
            (first, from) = (index + 2, at + line.len());
        }
        at += line.len();
    }
    parts.push((first, &text[from..]));
    let (kind, wanted) = (name.kind().folder(), name.kind().parts());
    let refused = || DefinitionError::new(name, 0, Problem::Parts(kind, wanted, parts.len()));
    if parts.len() == wanted { Ok(parts) } else { Err(refused()) }
}

fn service(name: &TypeName) -> [Definition; 2] {
    let of = |suffix| name.with(name.kind(), suffix);
    let bounded = Count::Sequence(Some(1));
    let info = TypeName::message("service_msgs", "ServiceEventInfo");
    let event = [
        Field::new(Base::Named(info), Count::One, "info"),
        Field::new(Base::Named(of("_Request")), bounded, "request"),
        Field::new(Base::Named(of("_Response")), bounded, "response"),
    ];
    let whole = [("request_message", "_Request"), ("response_message", "_Response"), ("event_message", "_Event")];
    let whole = whole.map(|(field, suffix)| named(field, of(suffix)));
    [message(of("_Event"), event), message(name.clone(), whole)]
}

/// Returns the messages of a ROS 2 action that contain its parts.
pub(crate) fn action(name: &TypeName) -> Vec<Definition> {
    let of = |suffix| name.with(InterfaceKind::Action, suffix);
    let goal_id = || named("goal_id", TypeName::message("unique_identifier_msgs", "UUID"));
    let scalar = |scalar, field| Field::new(Base::Scalar(scalar), Count::One, field);
    let stamp = named("stamp", TypeName::message("builtin_interfaces", "Time"));
    let mut all = vec![
        message(of("_SendGoal_Request"), [goal_id(), named("goal", of("_Goal"))]),
        message(of("_SendGoal_Response"), [scalar(Scalar::Bool, "accepted"), stamp]),
        message(of("_GetResult_Request"), [goal_id()]),
        message(of("_GetResult_Response"), [scalar(Scalar::Int8, "status"), named("result", of("_Result"))]),
        message(of("_FeedbackMessage"), [goal_id(), named("feedback", of("_Feedback"))]),
    ];
    all.extend(service(&of("_SendGoal")));
    all.extend(service(&of("_GetResult")));
    let whole = [
        ("goal", "_Goal"),
        ("result", "_Result"),
        ("feedback", "_Feedback"),
        ("send_goal_service", "_SendGoal"),
        ("get_result_service", "_GetResult"),
        ("feedback_message", "_FeedbackMessage"),
    ];
    all.push(message(name.clone(), whole.map(|(field, suffix)| named(field, of(suffix)))));
    all
}

/// Returns the messages of a ROS 1 action that contain its parts.
pub(crate) fn ros1_action(name: &TypeName) -> Vec<Definition> {
    let of = |suffix: &str| name.with(InterfaceKind::Message, suffix);
    let header = || named("header", TypeName::message("std_msgs", "Header"));
    let part = |field: &str, part: &str| named(field, TypeName::message("actionlib_msgs", part));
    let whole =
        [("action_goal", "ActionGoal"), ("action_result", "ActionResult"), ("action_feedback", "ActionFeedback")];
    vec![
        message(of("ActionGoal"), [header(), part("goal_id", "GoalID"), named("goal", of("Goal"))]),
        message(of("ActionResult"), [header(), part("status", "GoalStatus"), named("result", of("Result"))]),
        message(of("ActionFeedback"), [header(), part("status", "GoalStatus"), named("feedback", of("Feedback"))]),
        message(of("Action"), whole.map(|(field, suffix)| named(field, of(suffix)))),
    ]
}

fn message(name: TypeName, fields: impl Into<Vec<Field>>) -> Definition {
    Definition { name, constants: Vec::new(), fields: fields.into() }
}

fn named(field: &str, name: TypeName) -> Field {
    Field::new(Base::Named(name), Count::One, field)
}
