"""A ROS talker without ROS. GDP_KEYRING and GDP_SWITCH say as whom and where."""

import asyncio

import gdp


async def main() -> None:
    async with gdp.open() as session:
        talker = await session.ros_publisher("/chatter", "std_msgs/msg/String")
        for count in range(1, 1000):
            await talker.put({"data": f"hello {count} from Python"})
            await asyncio.sleep(0.2)


asyncio.run(main())
