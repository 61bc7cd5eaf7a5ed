// A node of roscpp: std_msgs/String and std_srvs/SetBool, as the programs in Python. See README.md.
//
// roscpp-peer talk|listen --topic TOPIC [--count N] [--rate HZ] [--size BYTES] [--text WORDS] [--transient-local] [--no-wait]
// roscpp-peer switch|set --service NAME

#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <string>

#include <boost/crc.hpp>
#include <ros/ros.h>
#include <std_msgs/String.h>
#include <std_srvs/SetBool.h>

struct Arguments {
  std::string topic = "/chatter", service = "/lamp", text = "hello from the robot";
  long count = 0, size = 64;
  double rate = 10;
  bool latch = false;
};

static Arguments parse(int argc, char** argv) {
  Arguments a;
  for (int i = 2; i < argc; i++) {
    std::string flag = argv[i];
    if (flag == "--transient-local") { a.latch = true; continue; }
    if (flag == "--no-wait" || i + 1 >= argc) continue;
    std::string value = argv[++i];
    if (flag == "--topic") a.topic = value;
    else if (flag == "--service") a.service = value;
    else if (flag == "--text") a.text = value;
    else if (flag == "--count") a.count = std::atol(value.c_str());
    else if (flag == "--size") a.size = std::atol(value.c_str());
    else if (flag == "--rate") a.rate = std::atof(value.c_str());
  }
  return a;
}

// In one go: callbacks run in threads of their own.
static void say(const std::string& event, const std::string& rest = "") {
  std::printf("%s\n", ("{\"event\":\"" + event + "\"" + rest + "}").c_str());
  std::fflush(stdout);
}

static long long nanoseconds() {
  timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1000000000LL + now.tv_nsec;
}

static unsigned long crc(const std::string& text) {
  boost::crc_32_type sum;
  sum.process_bytes(text.data(), text.size());
  return sum.checksum();
}

static void talk(ros::NodeHandle& node, const Arguments& a) {
  ros::Publisher publisher = node.advertise<std_msgs::String>(a.topic, 10, a.latch);
  std::string filler;
  while (static_cast<long>(filler.size()) < a.size - 43) filler += a.text + " ";
  filler.resize(a.size > 43 ? a.size - 43 : 0);
  say("ready");
  ros::WallRate rate(a.rate);
  for (long sequence = 0; ros::ok() && (a.count == 0 || sequence < a.count); sequence++) {
    char head[64];
    std::snprintf(head, sizeof head, "%010ld %020lld %010lu ", sequence, nanoseconds(), crc(filler));
    std_msgs::String message;
    message.data = head + filler;
    publisher.publish(message);
    rate.sleep();
  }
  say("done");
  ros::waitForShutdown();
}

static void receive(const std_msgs::String::ConstPtr& message) {
  const std::string& text = message->data;
  if (text.size() < 43) return;
  std::string filler = text.substr(43);
  bool intact = crc(filler) == std::strtoul(text.substr(32, 10).c_str(), nullptr, 10);
  say("message", ",\"seq\":" + std::to_string(std::atol(text.substr(0, 10).c_str())) +
                     ",\"bytes\":" + std::to_string(text.size()) + ",\"intact\":" + (intact ? "true" : "false") +
                     ",\"text\":\"" + filler.substr(0, 40) + "\"");
}

static void serve(ros::NodeHandle& node, const Arguments& a) {
  auto answer = [&](std_srvs::SetBool::Request& request, std_srvs::SetBool::Response& response) {
    response.success = request.data;
    response.message = a.service + " is " + (request.data ? "on" : "off");
    return true;
  };
  ros::ServiceServer server =
      node.advertiseService<std_srvs::SetBool::Request, std_srvs::SetBool::Response>(a.service, answer);
  say("ready");
  ros::waitForShutdown();
}

static void call(const Arguments& a) {
  ros::service::waitForService(a.service);
  for (bool value : {true, false}) {
    std_srvs::SetBool call;
    call.request.data = value;
    if (!ros::service::call(a.service, call)) say("error");
    say("response", ",\"service\":\"" + a.service + "\",\"success\":" + (call.response.success ? "true" : "false") +
                        ",\"message\":\"" + call.response.message + "\"");
  }
  ros::waitForShutdown();
}

int main(int argc, char** argv) {
  if (argc < 2) return 2;
  std::string verb = argv[1];
  ros::init(argc, argv, verb + "_" + std::to_string(getpid()), ros::init_options::NoRosout);
  ros::NodeHandle node;
  ros::AsyncSpinner spinner(2);
  spinner.start();
  Arguments a = parse(argc, argv);
  if (verb == "talk") talk(node, a);
  if (verb == "listen") {
    ros::Subscriber subscriber = node.subscribe(a.topic, 10, receive);
    say("ready");
    ros::waitForShutdown();
  }
  if (verb == "switch") serve(node, a);
  if (verb == "set") call(a);
}
