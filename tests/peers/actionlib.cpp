// A node of roscpp and actionlib: a server or a client of `test_msgs/Fibonacci`, as applications have them. Says what happens
// in lines of JSON, like `peer.py` of the ROS 1 node's tests.
//
// actionlib-peer NAME compute ACTION SECONDS    so many seconds for each number, with feedback; one goal at a time
// actionlib-peer NAME send ACTION ORDER [N]     cancels after the N-th feedback

#include <cstdio>
#include <cstdlib>
#include <string>

#include <actionlib/client/simple_action_client.h>
#include <actionlib/server/simple_action_server.h>
#include <ros/ros.h>
#include <test_msgs/FibonacciAction.h>

using Client = actionlib::SimpleActionClient<test_msgs::FibonacciAction>;
using Server = actionlib::SimpleActionServer<test_msgs::FibonacciAction>;

// In one go: callbacks run in threads of their own.
static void say(const std::string& event, const std::string& rest = "") {
  std::printf("%s\n", ("{\"event\":\"" + event + "\"" + rest + "}").c_str());
  std::fflush(stdout);
}

static void compute(const std::string& action, double seconds) {
  Server* server = nullptr;
  auto execute = [&](const test_msgs::FibonacciGoalConstPtr& goal) {
    say("goal", ",\"order\":" + std::to_string(goal->order));
    test_msgs::FibonacciFeedback feedback;
    test_msgs::FibonacciResult result;
    feedback.sequence = {0, 1};
    while (ros::ok() && static_cast<int>(feedback.sequence.size()) < goal->order) {
      result.sequence = feedback.sequence;
      if (server->isPreemptRequested()) {
        say("canceled");
        return server->setPreempted(result);
      }
      size_t count = feedback.sequence.size();
      unsigned sum = static_cast<unsigned>(feedback.sequence[count - 1]) + static_cast<unsigned>(feedback.sequence[count - 2]);
      feedback.sequence.push_back(static_cast<int>(sum & 0x7FFFFFFF));
      server->publishFeedback(feedback);
      ros::Duration(seconds).sleep();
    }
    result.sequence = feedback.sequence;
    server->setSucceeded(result, "it is long enough");
  };
  Server made(action, execute, false);
  server = &made;
  made.start();
  say("ready");
  ros::spin();
}

static void send(const std::string& action, int order, int cancel_after) {
  Client client(action, true);
  bool found = client.waitForServer(ros::Duration(30));
  say("server", std::string(",\"found\":") + (found ? "true" : "false"));
  int heard = 0;
  auto feedback = [&](const test_msgs::FibonacciFeedbackConstPtr& message) {
    say("feedback", ",\"length\":" + std::to_string(message->sequence.size()));
    if (++heard == cancel_after) client.cancelGoal();
  };
  test_msgs::FibonacciGoal goal;
  goal.order = order;
  client.sendGoal(goal, Client::SimpleDoneCallback(), Client::SimpleActiveCallback(), feedback);
  bool finished = client.waitForResult(ros::Duration(60));
  auto result = client.getResult();
  say("result", std::string(",\"finished\":") + (finished ? "true" : "false") + ",\"state\":\"" + client.getState().toString() +
                    "\",\"length\":" + std::to_string(result ? result->sequence.size() : 0));
}

int main(int argc, char** argv) {
  if (argc < 5) return 2;
  ros::init(argc, argv, argv[1], ros::init_options::NoRosout);
  ros::NodeHandle node;
  ros::AsyncSpinner spinner(2);
  std::string mode = argv[2];
  if (mode == "compute") compute(argv[3], std::atof(argv[4]));
  if (mode == "send") send(argv[3], std::atoi(argv[4]), argc > 5 ? std::atoi(argv[5]) : 0);
}
