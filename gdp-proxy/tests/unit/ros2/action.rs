//! Unit tests of `ros2::action`.

use super::*;

#[test]
fn an_action_is_three_services_and_two_topics() {
    let (name, kind) = (TopicName::parse("/arm/move").unwrap(), TypeName::parse("arm_msgs/action/Move").unwrap());
    let action = Action::new(&name, &kind).unwrap();
    let (send_goal, sends) = &action.send_goal;
    assert_eq!(send_goal.to_dds_service()[0], "rq/arm/move/_action/send_goalRequest");
    assert_eq!(sends.of_service()[0].to_dds(), "arm_msgs::action::dds_::Move_SendGoal_Request_");
    assert_eq!(action.feedback.1.to_dds(), "arm_msgs::action::dds_::Move_FeedbackMessage_");
    assert_eq!(action.status.0.to_dds(), "rt/arm/move/_action/status");
    assert_eq!(Action::part_of(send_goal), Some((name.clone(), "send_goal")));
    assert_eq!(Action::part_of(&name), None);
    assert_eq!(Action::kind_of(sends), Some(kind.clone()));
    let long = TopicName::parse(&format!("/{}", "a".repeat(240))).unwrap();
    assert!(Action::new(&long, &kind).is_err());
}
