//! The tree of all commands, and the texts below their `--help`.

use clap::{Parser, Subcommand};

use crate::{
    bag, completions, demo, doctor, foxglove, manual, new_robot, node, param, play, policy, record,
    service, snapshot, top, topic, up, wait_for, web_view, why,
};

/// Inspect, feed and run an SM2 domain from a shell.
#[derive(Debug, Parser)]
#[command(name = "sm2", version, after_help = EXAMPLES)]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// The commands, each in a module of its own.
#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Serve a domain: the broker that all its nodes connect to
    #[command(after_help = sm2_manager::program::examples("sm2 manager"))]
    Manager(sm2_manager::program::Arguments),
    /// Publish, print, list and measure topics
    #[command(subcommand, after_help = TOPIC_EXAMPLES)]
    Topic(topic::Command),
    /// List and call services
    #[command(subcommand, after_help = SERVICE_EXAMPLES)]
    Service(service::Command),
    /// List nodes, and show what one does
    #[command(subcommand, after_help = NODE_EXAMPLES)]
    Node(node::Command),
    /// Show, set, watch and store the parameters of nodes
    #[command(subcommand, after_help = PARAM_EXAMPLES)]
    Param(param::Command),
    /// Show the whole domain at one moment, or its changes
    Snapshot(snapshot::Arguments),
    /// Wait for conditions on topics, services and nodes
    Wait(wait_for::Arguments),
    /// Explain why two interfaces are linked, or why they are not
    Why(why::Arguments),
    /// Show rates and losses of a domain, live
    Top(top::Arguments),
    /// Show a domain in a web browser, live
    View(web_view::Arguments),
    /// Show topics and services in Foxglove; needs the program sm2-foxglove
    #[command(after_help = FOXGLOVE_EXAMPLES)]
    Foxglove(foxglove::Arguments),
    /// Check this machine, the Manager and the domain
    Doctor(doctor::Arguments),
    /// Record topics to a bag, an MCAP file
    Record(record::Arguments),
    /// Publish the messages of a bag again
    Play(play::Arguments),
    /// Show, check, recover and copy bags; needs no Manager
    #[command(subcommand, after_help = BAG_EXAMPLES)]
    Bag(bag::Command),
    /// Carry topics and services to other domains and machines
    #[command(subcommand, after_help = sm2_gateway::program::examples("sm2 gateway"))]
    Gateway(sm2_gateway::program::Command),
    /// Check access policies, and explain their decisions; needs no Manager
    #[command(subcommand, after_help = POLICY_EXAMPLES)]
    Policy(policy::Command),
    /// Make a folder with the nodes of a small robot in Rust
    New(new_robot::Arguments),
    /// Start the programs of a robot in order, restart them, and end them
    Up(up::Arguments),
    /// Measure large messages on this machine; needs no Manager
    Demo(demo::Arguments),
    /// Print a shell's completion script for this command
    Completions(completions::Arguments),
    /// Print a manual page, or write all of them to a folder
    Man(manual::Arguments),
    /// One process of the demo: [`sm2_demo::COMMAND`], which is not meant for people.
    #[command(skip)]
    DemoPart(sm2_demo::ProcessArguments),
    /// The guard of `sm2 up`: [`up::GUARD`], which is not meant for people.
    #[command(skip)]
    UpGuard(up::GuardArguments),
}

const EXAMPLES: &str = "\
Exit status: 0 done, 1 failed or the answer is no, 2 wrong usage, 130 or 143 ended by Ctrl-C or
SIGTERM before it was done. A second Ctrl-C ends a command at once.

Environment: SM2_SOCKET, SM2_DOMAIN and XDG_RUNTIME_DIR determine the path of the Manager's socket;
SM2_LOG (error, warn, info, debug) sets the level of the log on standard error.

When the Manager ends, commands that run for a while (echo, pub, hz, bw, delay, loss, top, wait,
snapshot --watch) report it on standard error and wait for the next Manager. Links stay meanwhile.

The node of a command is named sm2-COMMAND-PID. Lists leave out the command that prints them.

Examples:
  sm2 manager                              serve the default domain
  echo hello | sm2 topic pub chatter --from -
  sm2 topic echo chatter                   print what is published
  sm2 topic hz chatter                     measure the rate, without subscribing
  sm2 topic list --json                    list all topics, for a program
  sm2 wait 'topic:/scan publishers>=1' --timeout 5s
  sm2 why talker listener                  explain why they are linked, or not
  sm2 doctor                               find problems of this machine
  sm2 up robot.toml                        start the programs of a robot in order
  sm2 demo --seconds 5 --integrity sealed  5 subscribers, 10 MB, 30 Hz";

const TOPIC_EXAMPLES: &str = "\
hz, bw, delay and loss read counters that every node keeps; they do not subscribe.

Examples:
  sm2 topic list
  sm2 topic info scan
  sm2 topic echo scan --count 1
  sm2 topic hz scan";

const SERVICE_EXAMPLES: &str = "\
Examples:
  sm2 service list
  sm2 service info sum
  sm2 service call sum '[1, 2, 3]'";

const NODE_EXAMPLES: &str = "\
Examples:
  sm2 node list
  sm2 node info talker";

const PARAM_EXAMPLES: &str = "\
Examples:
  sm2 param list lidar
  sm2 param set lidar max_range 12.5
  sm2 param dump lidar > lidar.toml";

const FOXGLOVE_EXAMPLES: &str = "\
The program is in the folder of this one, or in a folder of $PATH: `cargo install --path sm2-foxglove`.

Examples:
  sm2 foxglove
  sm2 foxglove --listen 127.0.0.1:0 scan 'camera/**'";

const BAG_EXAMPLES: &str = "\
Examples:
  sm2 bag info drive.mcap
  sm2 bag check drive.mcap
  sm2 bag recover drive.mcap
  sm2 bag filter drive.mcap --topic scan -o scan.mcap";

const POLICY_EXAMPLES: &str = "\
A policy file states who may publish, subscribe, serve, call, see and read counters under which names.
`sm2 manager --policy FILE` applies one to a domain; without a policy everything is allowed.

Examples:
  sm2 policy check policy.toml
  sm2 policy explain policy.toml --node talker --action publish --name chatter
  sm2 policy learn
  sm2 policy reload";
